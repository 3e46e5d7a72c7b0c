from exceptiondrive_endpoints.endpoint import (
    AnswerForm,
    Dialect,
    ModelSettings,
    plainer,
    request_body,
)

MODEL = ModelSettings(model="m", max_tokens=77, extra={"seed": 1})


def body(dialect: Dialect) -> dict[str, object]:
    return request_body(MODEL, dialect, [{"role": "user"}], "decide", {"type": "object"})


def test_the_first_dialect_asks_by_strict_schema() -> None:
    assert body(Dialect()) == {
        "model": "m",
        "messages": [{"role": "user"}],
        "max_tokens": 77,
        "temperature": 0.0,
        "response_format": {
            "type": "json_schema",
            "json_schema": {"name": "decide", "strict": True, "schema": {"type": "object"}},
        },
        "seed": 1,
    }


def test_refusals_without_a_cause_lead_from_schema_to_object_to_words_to_nothing() -> None:
    forms = []
    dialect: Dialect | None = Dialect()
    while dialect is not None:
        forms.append(dialect.form)
        dialect = plainer(dialect, None)
    assert forms == [AnswerForm.JSON_SCHEMA, AnswerForm.JSON_OBJECT, AnswerForm.WORDS]


def test_in_words_no_response_format_is_sent() -> None:
    assert "response_format" not in body(Dialect(form=AnswerForm.WORDS))


def test_a_refused_token_limit_is_renamed_and_a_refused_temperature_left_out() -> None:
    renamed = plainer(Dialect(), "max_tokens")
    assert renamed is not None
    assert body(renamed)["max_completion_tokens"] == 77
    assert "max_tokens" not in body(renamed)
    silent = plainer(renamed, "temperature")
    assert silent is not None
    assert "temperature" not in body(silent)
    assert silent.form is AnswerForm.JSON_SCHEMA


def test_asking_ends_even_when_the_same_field_is_refused_for_ever() -> None:
    for field in ("max_tokens", "temperature", "model", None):
        tries = 0
        dialect: Dialect | None = Dialect()
        while dialect is not None:
            dialect = plainer(dialect, field)
            tries += 1
        assert tries <= 4
