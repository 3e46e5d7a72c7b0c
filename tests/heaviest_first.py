"""A pytest plugin: the files that take longest come first, so that no process idles at the end.

xdist would start with the files of most tests; a browser or a deployment of its own has few.
"""

import pytest

HEAVIEST = (
    "tests/rescoring/test_organizer_in_a_browser.py",
    "tests/launcher/test_launch.py",
    "tests/server/pages/test_in_a_browser.py",
    "tests/end_to_end/test_images_to_ranked_entry.py",
    "tests/access/test_real_server.py",
    "tests/operating/test_running_server.py",
    "tests/records/test_lifecycle_machine.py",
    "tests/phases/test_in_a_browser.py",
    "tests/chaos/test_short_form.py",
    "tests/server/test_openapi.py",
    "tests/end_to_end/test_main_job.py",
    "tests/end_to_end/test_in_the_browser.py",
    "tests/operating/test_production_topology.py",
    "tests/worker/test_with_real_broker.py",
)
"""More than 20 s each, by measurement."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {path: place for place, path in enumerate(HEAVIEST)}
    items.sort(key=lambda item: rank.get(item.nodeid.partition("::")[0], len(rank)))
