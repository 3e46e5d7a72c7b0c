"""Markdown that organizers write, as somebody hostile would write it."""

import re

import pytest
from tests.server.nasty_strings import ALL
from tests.server.test_injection import assert_inert

from exceptiondrive_schemas.printable import printable
from exceptiondrive_server.web.markdown import first_paragraph, markdown, plain_text

HOSTILE = {
    "script": "<script>alert(1)</script>",
    "script across lines": "a\n\n<script\n>alert(1)</script\n>",
    "handler": '<b onmouseover="alert(1)">x</b>',
    "javascript link": "[x](javascript:alert(1))",
    "javascript link, hidden": "[x](java\tscript:alert(1)) [y](&#106;avascript:alert(1))",
    "javascript autolink": "<javascript:alert(1)>",
    "data link": "[x](data:text/html;base64,PHNjcmlwdD4=)",
    "file link": "[x](file:///etc/passwd)",
    "borrowed scheme": "[x](//evil.example/)",
    "plain http": "[x](http://evil.example/)",
    "picture": "![x](https://evil.example/who-reads.png)",
    "picture by reference": "![x][1]\n\n[1]: https://evil.example/who-reads.png",
    "frame": '<iframe src="https://evil.example"></iframe>',
    "style": "<style>*{display:none}</style>",
    "svg": '<svg onload="alert(1)">',
    "form": '<form action="https://evil.example"><input name="token"></form>',
    "attribute in a link": '[x](https://a.example "\\"onmouseover=alert(1) x=\\"")',
    "entity": "&lt;script&gt;alert(1)&lt;/script&gt;",
    "code": "```\n</code></pre><script>alert(1)</script>\n```",
    "comment": "<!-- --!><script>alert(1)</script> -->",
    "unclosed": "<p><b><a href='https://a.example'",
}
LONG = 20_000
PIECES = ("[", "![", "*", "_a_", "> ", "- ", "`", "<", "\\", "[a](", "|", "a|b\n-|-\n", "&", "~~")


@pytest.mark.parametrize("key", HOSTILE)
def test_hostile_markdown_can_do_nothing(key: str) -> None:
    html = str(markdown(HOSTILE[key]))
    seen = assert_inert(html)
    tags = {tag for tag, _ in seen.found}
    assert tags <= {"p", "a", "pre", "code", "b", "blockquote"}
    assert not tags & {"script", "img", "iframe", "style", "svg", "form", "input", "b"}
    for tag, attributes in seen.found:
        given = {"a": {"href", "rel"}, "pre": {"tabindex"}}
        assert set(attributes) <= given.get(tag, set())
        assert (attributes.get("href") or "https://").startswith(("https://", "mailto:"))


def test_a_block_of_code_takes_the_keyboard_which_scrolls_it() -> None:
    assert '<pre tabindex="0"><code>' in markdown(f"```\n{'x' * 300}\n```")
    assert "tabindex" not in markdown("`<pre>` is a tag")


@pytest.mark.parametrize("key", ALL)
def test_every_nasty_string_is_inert_as_markdown(key: str) -> None:
    seen = assert_inert(printable(str(markdown(ALL[key]))))
    assert not {"script", "img"} & {tag for tag, _ in seen.found}


@pytest.mark.parametrize("piece", PIECES)
def test_the_longest_text_of_the_worst_kind_is_rendered(piece: str) -> None:
    text = (piece * LONG)[:LONG]
    assert assert_inert(str(markdown(text))) is not None


def test_what_is_harmless_stays() -> None:
    html = str(
        markdown(
            "# Rules\n\n**Bold**, *em*, `code`, [site](https://a.example) and "
            "[mail](mailto:a@a.example), [here](/splits/x).\n\n1. one\n2. two\n\n"
            "| a | b |\n|---|---|\n| 1 | 2 |"
        )
    )
    for part in (
        "<h3>Rules</h3>", "<strong>Bold</strong>", "<em>em</em>", "<code>code</code>",
        'href="https://a.example"', 'href="mailto:a@a.example"', 'href="/splits/x"',
        "<li>one</li>", "<td>1</td>", 'rel="nofollow noopener noreferrer"',
    ):  # fmt: skip
        assert part in html


def test_a_heading_never_stands_above_those_of_the_page() -> None:
    html = str(markdown("\n\n".join(f"{'#' * level} h" for level in range(1, 7))))
    assert "<h1" not in html
    assert "<h2" not in html
    assert html.count("<h6>") == 3


@pytest.mark.parametrize(
    ("text", "below", "levels"),
    [
        ("## a\n\n#### b\n\n## c", 2, "343"),
        ("### a\n\n# b\n\n### c\n\n#### d", 2, "3345"),
        ("# a\n\n## b", 1, "23"),
    ],
)
def test_no_level_of_headings_is_skipped(text: str, below: int, levels: str) -> None:
    assert "".join(re.findall(r"<h(\d)", str(markdown(text, below)))) == levels


def test_the_first_paragraph_stands_alone() -> None:
    text = "# Title\n\nFirst *words*\nof it.\n\nSecond."
    assert str(first_paragraph(text)) == "<p>First <em>words</em>\nof it.</p>\n"
    assert str(first_paragraph("# Title")) == ""
    assert str(first_paragraph("> Quoted.\n\nOne\u2028line.\n\nMore.")) == "<p>One\u2028line.</p>\n"


@pytest.mark.parametrize(
    ("written", "plain"),
    [
        ("It is on **Friday** now.", "It is on Friday now."),
        ("# Head\n\nA *b* `c`\nd", "Head\n\nA b c\nd"),
        ("- one\n- [two](https://a.example/x)", "- one\n\n- two (https://a.example/x)"),
        ("-\n\nafter", "after"),
        ("3. a\n4. b\n\n   c", "3. a\n\n4. b\n\nc"),
        ("Look [here](https://a.example/here).", "Look here (https://a.example/here)."),
        ("See <https://a.example/> or <a@b.example>", "See https://a.example/ or a@b.example"),
        ("|a|b|\n|-|-|\n|*1*|2|\n||3|", "a | b\n\n1 | 2\n\n | 3"),
        ("```\nx = 1\n```\n\n1 \\* 2 &amp; 3", "x = 1\n\n1 * 2 & 3"),
        ("---", ""),
    ],
)
def test_an_inbox_has_the_words_and_of_their_marks_those_of_items_and_cells(
    written: str, plain: str
) -> None:
    assert plain_text(written) == plain
