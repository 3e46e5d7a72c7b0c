"""The links in header and footer of every page, from the command line."""

from collections.abc import Callable
from typing import Any

from exceptiondrive.cli import options
from exceptiondrive.cli.organizer.phases import setting_document, with_settings
from exceptiondrive.cli.output import show_result
from exceptiondrive.cli.session import open_organizer
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_schemas.api.site import SiteLinks


def show_site(server: options.Server = None, json: options.Json = False) -> None:
    """Show the links of the site."""
    with open_organizer(server) as organizer:
        _show(organizer.site(), json)


def set_site(server: options.Server = None, json: options.Json = False, **links: Any) -> None:
    """Set links of the site; what is left out stays, an empty one is not shown."""
    changes = setting_document(SiteLinks, links)
    if not changes:
        raise InvalidArgumentError("nothing_to_set", "Say what to set: `--help` lists the links.")
    with open_organizer(server) as organizer:
        _show(organizer.set_site(changes), json)


def _show(links: dict[str, Any], json: bool) -> None:
    show_result(links, json, *(f"{name:<9}  {text or '-'}" for name, text in links.items()))


COMMANDS: dict[str, Callable[..., None]] = {
    "show": show_site,
    "set": with_settings(set_site, SiteLinks),
}
