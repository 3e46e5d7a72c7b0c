"""A console that shows what a server sent without letting it steer the terminal."""

from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from exceptiondrive_schemas.printable import printable


class SafeConsole(Console):
    """Rich's console; control characters in what is shown become replacement signs.

    Rich itself lets ESC through. Its own colours and cursor movements are not in the text of
    segments and stay.
    """

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Yield what is shown, cleaned."""
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield Segment(printable(segment.text), segment.style)
