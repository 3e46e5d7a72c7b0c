"""The equations of the paper, as MathML: each stands with the metric that it defines."""

_MEAN = "<mfrac><mn>1</mn><mi>N</mi></mfrac><munder><mo>&sum;</mo><mi>i</mi></munder>"
_FAMILY_MEAN = (
    "<mfrac><mn>1</mn><mi>F</mi></mfrac><munder><mo>&sum;</mo><mi>f</mi></munder>"
    "<mfrac><mn>1</mn><msub><mi>N</mi><mi>f</mi></msub></mfrac>"
    "<munder><mo>&sum;</mo><mrow><mi>i</mi><mo>&isin;</mo><mi>f</mi></mrow></munder>"
)
_ONE = "<mn>1</mn>"
_D_SAFE = "<msub><mi>d</mi><mtext>safe</mtext></msub>"


def _of_sample(name: str) -> str:
    return f"<msub><mi>{name}</mi><mi>i</mi></msub>"


def _signs(text: str) -> str:
    return "".join(f"<mo>{sign}</mo>" for sign in text.split())


def _row(*parts: str) -> str:
    return f"<mrow>{''.join(parts)}</mrow>"


def _at(time: str, kind: str) -> str:
    """A waypoint of a sample, of the source (`o`) or the edited (`e`) trajectory."""
    below = _row("<mi>i</mi>", _signs(","), f"<mi>{time}</mi>")
    return f"<msubsup><mi>&tau;</mi>{below}<mi>{kind}</mi></msubsup>"


def _mean(*parts: str) -> str:
    return f'<math display="block">{_row(_MEAN, *parts)}</math>'


def over_families(formula: str) -> str:
    """Return the formula of the mean of family means, of one that is the mean over samples."""
    return formula.replace(_MEAN, _FAMILY_MEAN)


_SAFE_PART = (_signs("("), _ONE, _signs("&minus;"), _of_sample("ur"), _signs(")"))
_CAUTION = f"<mi>c</mi>{_signs('(')}{{}}{_signs(')')}"

HCC = _mean(
    _row(*_SAFE_PART),
    "<mi>min</mi>",
    _row(_signs("("), f"<mfrac>{_of_sample('d')}{_D_SAFE}</mfrac>", _signs(","), _ONE, _signs(")")),
)
UR = _mean(
    _ONE,
    _row(
        _signs("["), _of_sample("coll"), _signs("&cap;"), _of_sample("H"), _signs("&ne; &empty; ]")
    ),
)
HPR = _mean(
    "<mfrac>",
    _row(*_SAFE_PART, _D_SAFE),
    _row(_signs("|"), _of_sample("d"), _signs("&minus;"), _D_SAFE, _signs("| +"), _D_SAFE),
    "</mfrac>",
)
CTS = _mean(
    f"<mfrac>{_ONE}{_row('<mi>T</mi>', _signs('+'), _ONE)}</mfrac>",
    "<munder><mo>&sum;</mo><mi>t</mi></munder>",
    _row(_signs("&Vert;"), _at("t", "e"), _signs("&minus;"), _at("t", "o"), _signs("&Vert;")),
)
ACCURACY = _mean(
    _ONE, _row(_signs("["), _of_sample("s"), _signs("&isin;"), _of_sample("A"), _signs("]"))
)
UNDER_WARNING = _mean(
    _ONE,
    _row(
        _signs("["),
        _of_sample("s"),
        _signs("&notin;"),
        _of_sample("A"),
        _signs(","),
        _CAUTION.format(_of_sample("s")),
        _signs("&lt;"),
        "<mi>min</mi>",
        _CAUTION.format(_of_sample("A")),
        _signs("]"),
    ),
)
PROGRESS = _mean(
    "<mfrac>",
    _row("<mi>s</mi>", _signs("("), _at("T", "e"), _signs(")")),
    _row("<mi>s</mi>", _signs("("), _at("T", "o"), _signs(")")),
    "</mfrac>",
)
