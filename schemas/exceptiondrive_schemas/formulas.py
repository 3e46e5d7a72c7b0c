"""The equations of the paper, as MathML: each belongs to the metric that it defines."""

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


def _operators(text: str) -> str:
    return "".join(f"<mo>{sign}</mo>" for sign in text.split())


def _math_row(*parts: str) -> str:
    return f"<mrow>{''.join(parts)}</mrow>"


def _waypoint_at(time: str, kind: str) -> str:
    """Return a waypoint of a sample, of the source (`o`) or the edited (`e`) trajectory."""
    below = _math_row("<mi>i</mi>", _operators(","), f"<mi>{time}</mi>")
    return f"<msubsup><mi>&tau;</mi>{below}<mi>{kind}</mi></msubsup>"


def _mean_formula(*parts: str) -> str:
    return f'<math display="block">{_math_row(_MEAN, *parts)}</math>'


def over_families(formula: str) -> str:
    """Return the formula of the mean of family means, given that of the mean over samples."""
    return formula.replace(_MEAN, _FAMILY_MEAN)


_SAFE_PART = (_operators("("), _ONE, _operators("&minus;"), _of_sample("ur"), _operators(")"))
_CAUTION = f"<mi>c</mi>{_operators('(')}{{}}{_operators(')')}"

HCC = _mean_formula(
    _math_row(*_SAFE_PART),
    "<mi>min</mi>",
    _math_row(
        _operators("("),
        f"<mfrac>{_of_sample('d')}{_D_SAFE}</mfrac>",
        _operators(","),
        _ONE,
        _operators(")"),
    ),
)
UR = _mean_formula(
    _ONE,
    _math_row(
        _operators("["),
        _of_sample("coll"),
        _operators("&cap;"),
        _of_sample("H"),
        _operators("&ne; &empty; ]"),
    ),
)
HPR = _mean_formula(
    "<mfrac>",
    _math_row(*_SAFE_PART, _D_SAFE),
    _math_row(
        _operators("|"), _of_sample("d"), _operators("&minus;"), _D_SAFE, _operators("| +"), _D_SAFE
    ),
    "</mfrac>",
)
CTS = _mean_formula(
    f"<mfrac>{_ONE}{_math_row('<mi>T</mi>', _operators('+'), _ONE)}</mfrac>",
    "<munder><mo>&sum;</mo><mi>t</mi></munder>",
    _math_row(
        _operators("&Vert;"),
        _waypoint_at("t", "e"),
        _operators("&minus;"),
        _waypoint_at("t", "o"),
        _operators("&Vert;"),
    ),
)
ACCURACY = _mean_formula(
    _ONE,
    _math_row(
        _operators("["), _of_sample("s"), _operators("&isin;"), _of_sample("A"), _operators("]")
    ),
)
UNDER_WARNING = _mean_formula(
    _ONE,
    _math_row(
        _operators("["),
        _of_sample("s"),
        _operators("&notin;"),
        _of_sample("A"),
        _operators(","),
        _CAUTION.format(_of_sample("s")),
        _operators("&lt;"),
        "<mi>min</mi>",
        _CAUTION.format(_of_sample("A")),
        _operators("]"),
    ),
)
PROGRESS = _mean_formula(
    "<mfrac>",
    _math_row("<mi>s</mi>", _operators("("), _waypoint_at("T", "e"), _operators(")")),
    _math_row("<mi>s</mi>", _operators("("), _waypoint_at("T", "o"), _operators(")")),
    "</mfrac>",
)
