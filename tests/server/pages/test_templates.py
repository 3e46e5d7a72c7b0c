"""How templates are written, and what of it is sent."""

import re
from pathlib import Path
from typing import Any

import pytest
from markupsafe import Markup

import exceptiondrive_server
from exceptiondrive_server.web.templating import condensed, unbroken

TEMPLATES = sorted(
    path
    for ending in ("html", "svg")
    for path in Path(exceptiondrive_server.__file__).parent.rglob(f"templates/**/*.{ending}")
)
BEGINS_A_LINE = re.compile(r"<(article|div|dd|dl|dt|form|li|ol|option|p|section|t[dhr]|ul)\b")


STYLES = sorted(Path(exceptiondrive_server.__file__).parent.glob("web/static/*.css"))


@pytest.mark.parametrize("path", STYLES, ids=lambda path: path.name)
def test_every_brace_of_a_style_has_its_other(path: Path) -> None:
    """A brace too many takes the rule behind it out, in whatever file that stands."""
    depth = 0
    for number, line in enumerate(
        re.sub(r"/\*.*?\*/", "", path.read_text(), flags=re.DOTALL).splitlines(), 1
    ):
        for sign in re.findall(r"[{}]", line):
            depth += 1 if sign == "{" else -1
            assert depth >= 0, f"line {number} closes what nothing opened"
    assert depth == 0


def test_there_are_templates() -> None:
    assert len(TEMPLATES) > 50


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_template_has_short_lines_and_one_block_a_line(path: Path) -> None:
    for number, line in enumerate(path.read_text().splitlines(), 1):
        assert len(line) <= 120, f"line {number} has {len(line)} columns"
        assert len(BEGINS_A_LINE.findall(line)) <= 1, f"line {number} begins several blocks: {line}"


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_text_that_the_keyboard_reaches_has_a_role_for_its_name(path: Path) -> None:
    """A name of an element without a role is not read out."""
    for text in re.findall(r"<pre\b[^>]*>", path.read_text()):
        assert ("tabindex=" in text) == ('role="group"' in text), text


@pytest.mark.parametrize(
    ("written", "sent"),
    [
        ("<b>a</b>\n  <i>b</i>", "<b>a</b><i>b</i>"),
        ("<b>a</b> <i>b</i>", "<b>a</b> <i>b</i>"),
        ("<p>\n  text\n  <b>bold</b>,\n  more\n</p>", "<p>text <b>bold</b>, more</p>"),
        ("text<br>\nmore", "text<br> more"),
        ("<p>\n  {% if x %}\n    a\n  {% else %}\n    b\n  {% endif %}\n</p>", "<p>{% if x %}a{% else %}b{% endif %}</p>"),
        ("a.\n{% if x %}\n  b.\n{% endif %}\nc", "a. {% if x %}b. {% endif %}c"),
        ("<b>a</b>\n{% if x %}\n  <i>b</i>\n{% endif %}\n<u>c</u>", "<b>a</b>{% if x %}<i>b</i>{% endif %}<u>c</u>"),
        ('<b>a</b>\n{{ icon("up") }}\n<i>b</i>', '<b>a</b>{{ icon("up") }}<i>b</i>'),
        ("<b>a</b>\n{% call c() %}\n  text\n{% endcall %}", "<b>a</b>{% call c() %}text{% endcall %}"),
        ("<b>a</b>\n{{ text }}\n<i>b</i>", "<b>a</b> {{ text }} <i>b</i>"),
        ('<a\n  href="{{ at(">") }}"\n  {% if x > 1 %}hidden{% endif %}\n>', '<a href="{{ at(">") }}" {% if x > 1 %}hidden{% endif %} >'),
        ("<pre>\n a\n <b>b</b>\n</pre>\n<p>", "<pre>\n a\n <b>b</b>\n</pre><p>"),
        ("<b>a</b>\n{%- if x %}, b{% endif %}.", "<b>a</b>{%- if x %}, b{% endif %}."),
        ("{% macro a() %}\n  text\n{% endmacro %}\nmore", "{% macro a() %}text{% endmacro %}more"),
    ],
)  # fmt: skip
def test_a_line_break_is_layout_but_in_running_text(written: str, sent: str) -> None:
    assert re.sub(r"\{#\n*#\}", "", condensed(written)) == sent


def test_every_line_keeps_its_number() -> None:
    for path in TEMPLATES:
        assert condensed(path.read_text()).count("\n") == path.read_text().count("\n")


def test_an_option_of_a_command_is_never_parted_and_nothing_else_is_touched() -> None:
    shown = unbroken('curl -s "a-b" \\\n    --allow-all <x> https://h.test/--no')
    assert shown == (
        "curl <i>-s</i> &#34;a-b&#34; \\\n    <i>--allow-all</i> &lt;x&gt; https://h.test/--no"
    )
    assert unbroken(Markup("<b>    --phase x</b> - y")) == "<b>    <i>--phase</i> x</b> - y"


@pytest.mark.parametrize("path", ["/", "/phases/sample", "/compare", "/entries/s0000000kq"])
async def test_no_page_shows_a_blank_before_a_comma_or_a_colon(shown_site: Any, path: str) -> None:
    answer = await shown_site.get(path)
    assert answer.status_code == 200
    shown = re.sub(r"</?(a|b|code|span|time)\b[^>]*>", "", answer.text)
    assert re.findall(r"[^<>]{0,40}\w [,:;](?=\s)[^<>]{0,20}", shown) == []
