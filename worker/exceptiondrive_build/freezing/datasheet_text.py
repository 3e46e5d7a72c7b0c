"""A datasheet as text: Markdown, and one self-contained HTML page."""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

from exceptiondrive_schemas.datasheet import Agreement, Audit, Datasheet, Interval
from exceptiondrive_schemas.printable import counted, percent_of

_QUESTIONS = {
    "purpose": "For what purpose",
    "source": "What it is made from",
    "uses": "What it is for, and what it is not for",
    "limits": "Known limits",
    "licence": "Licence",
    "maintenance": "Who keeps it, and how",
    "contact": "Contact",
    "url": "Where",
    "published": "Published",
}
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;
color-scheme:light dark}
table{border-collapse:collapse;margin:.6rem 0}caption,th,td{text-align:left}
th,td{padding:.2rem .8rem .2rem 0;border-bottom:1px solid #8886}
td.n{text-align:right;font-variant-numeric:tabular-nums}
figure{display:inline-block;margin:.5rem 1rem .5rem 0}img{max-width:20rem;height:auto}
.wide{overflow-x:auto}
"""


@dataclass(frozen=True)
class _Section:
    """A heading, sentences below it, and a table; each may be missing."""

    title: str
    sentences: tuple[str, ...] = ()
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()


def markdown_of(sheet: Datasheet) -> str:
    """Return the datasheet as Markdown, without pictures."""
    lines = [f"# {_flat(sheet.title)}", ""]
    for section in _sections(sheet):
        lines += [f"## {section.title}", ""]
        lines += [line for sentence in section.sentences for line in (_flat(sentence), "")]
        if section.head:
            lines += [_row(section.head), _row(["---"] * len(section.head))]
            lines += [*map(_row, section.rows), ""]
    return "\n".join(lines)


def html_of(sheet: Datasheet) -> str:
    """Return the datasheet as a page, with pictures."""
    body = "".join(map(_section_html, _sections(sheet)))
    figures = "".join(
        f"<figure>{_img(example.source, 'source')}{_img(example.edited, 'edited')}"
        f"<figcaption>{escape(example.caption) or 'source, edited'}</figcaption></figure>"
        for example in sheet.examples
    )
    licence = f"<p>Licence of the pictures: {escape(sheet.picture_licence)}.</p>"
    examples = (
        f"<h2>Examples</h2>{figures}{licence if sheet.picture_licence else ''}" if figures else ""
    )
    title = escape(sheet.title)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{title}</title><style>{_STYLE}</style></head>"
        f"<body><main><h1>{title}</h1>{body}{examples}</main></body></html>\n"
    )


def _sections(sheet: Datasheet) -> Iterable[_Section]:
    yield _Section(
        "The split",
        head=("what", "value"),
        rows=(
            ("name", sheet.name),
            ("revision", sheet.revision),
            ("protocol", sheet.protocol),
            ("samples that count (N)", f"{sheet.n_samples:,}"),
            ("scenes", f"{sheet.n_scenes:,}"),
            ("control samples", f"{sheet.n_controls:,}"),
            ("withdrawn samples", f"{sheet.n_withdrawn:,}"),
            ("of samples and controls with a recorded path", f"{sheet.n_recorded:,}"),
        ),
    )
    words = sheet.words.model_dump()
    for key, question in _QUESTIONS.items():
        if words[key]:
            links = (sheet.words.licence_url,) if key == "licence" else ()
            yield _Section(question, (words[key], *filter(None, links)))
    if sheet.changes is not None:
        change = sheet.changes
        counts = "; ".join(change.counts) or "no sample changed"
        since = f"Since revision {change.previous}: {counts}."
        yield _Section("What changed", (change.words, since))
    if sheet.withdrawn:
        yield _Section(
            "Withdrawn samples",
            ("Files still answer them, no sheet counts them.",),
            ("reason", "samples"),
            tuple((group.reason, f"{group.n:,}") for group in sheet.withdrawn),
        )
    yield _Section(
        "How it came about",
        head=("stage", "candidates", "of", "share"),
        rows=tuple(
            (stage.title, f"{stage.n:,}", f"{stage.of:,}", percent_of(stage.n, stage.of))
            for stage in sheet.stages
        ),
    )
    for title, cells in (("Families", sheet.families), ("Tasks", sheet.tasks)):
        yield _Section(
            title,
            head=("id", "name", "candidates", "suitable", "accepted", "in N", "share of N"),
            rows=tuple(
                (
                    cell.id,
                    cell.title,
                    *(f"{n:,}" for n in (cell.candidates, cell.suitable, cell.accepted, cell.n)),
                    percent_of(cell.n, sheet.n_samples),
                )
                for cell in cells
            ),
        )
    if sheet.audit is not None:
        yield _Section("Audit", (_audit(sheet.audit),))
    if sheet.agreement is not None:
        yield _Section("Agreement of two readers about regions", (_agreement(sheet.agreement),))
    if sheet.deciders:
        yield _Section(
            "Who decided",
            ("People are numbered anew in each revision.",),
            ("stage", "by", "decisions", "prompt"),
            tuple(
                (each.stage, each.by, f"{each.decisions:,}", each.prompt[:19])
                for each in sheet.deciders
            ),
        )
    yield _Section(
        "Warnings of lint",
        () if sheet.warnings else ("None.",),
        ("code", "count", "what") if sheet.warnings else (),
        tuple((found.code, f"{found.count:,}", found.what) for found in sheet.warnings),
    )


def _audit(audit: Audit) -> str:
    waiting = (
        f" {audit.waiting:,} more were drawn, and wait to be looked at." if audit.waiting else ""
    )
    return (
        f"Of {audit.accepted:,} edits that passed the review, {audit.drawn:,} were drawn at random "
        f"and looked at by people; {audit.passed:,} passed, "
        f"{percent_of(audit.passed, audit.drawn)}. {audit.confidence:.0%} intervals: "
        f"{_interval(audit.wilson)} (Wilson), {_interval(audit.finite_population)} (for a draw "
        f"from so many).{waiting}"
    )


def _agreement(found: Agreement) -> str:
    alpha = "undefined: all words are the same" if found.alpha is None else f"{found.alpha:.3f}"
    text = (
        f"Read twice, blind: {counted(found.n, 'candidate')}, {counted(found.same_word, 'time')} with "
        f"the same word, {counted(found.beyond, 'time')} so far apart that a third reader decides. "
        f"Krippendorff's alpha over accepted and rejected is {alpha}."
    )
    if found.iou_mean is None or found.iou_median is None or found.corner_m_max is None:
        return text
    return (
        f"{text} Over the {found.both_accepted:,} that both accepted, intersection over union is "
        f"{found.iou_mean:.3f} on average (median {found.iou_median:.3f}); corners lie at most "
        f"{found.corner_m_max:.2f} m apart."
    )


def _interval(interval: Interval) -> str:
    return f"{100 * interval[0]:.2f} to {100 * interval[1]:.2f} %"


def _flat(text: str) -> str:
    """Return text on one line in which Markdown sees no tag."""
    return " ".join(escape(text, quote=False).split())


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(_flat(cell).replace("|", "\\|") for cell in cells) + " |"


def _section_html(section: _Section) -> str:
    sentences = "".join(f"<p>{escape(sentence)}</p>" for sentence in section.sentences)
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in section.head)
    rows = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in section.rows)
    table = f'<div class="wide"><table><tr>{head}</tr>{rows}</table></div>' if head else ""
    return f"<h2>{escape(section.title)}</h2>{sentences}{table}"


def _cell(text: str) -> str:
    is_number = text[:1].isdigit() and text.replace(",", "").replace(".", "").rstrip(" %").isdigit()
    return f'<td class="n">{text}</td>' if is_number else f"<td>{escape(text)}</td>"


def _img(jpeg: bytes, alt: str) -> str:
    return f'<img alt="{alt}" src="data:image/jpeg;base64,{b64encode(jpeg).decode()}">'
