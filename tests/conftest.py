"""Real databases, brokers and browsers for all tests; nothing is mocked. See tests/support."""

pytest_plugins = [
    "tests.canary.plugin",  # the whole run is searched for a withheld coordinate
    "tests.chaos.story",
    "tests.support.broker",
    "tests.support.browser",
    "tests.support.databases",
    "tests.support.order",
    "tests.support.snapshots",
    "tests.support.speed",
]
