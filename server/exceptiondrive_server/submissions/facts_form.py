"""The form for facts of a method: fields made from the schema, names prefixed."""

from dataclasses import replace

from starlette.datastructures import FormData

from exceptiondrive_schemas.api.form_fields import fields_of
from exceptiondrive_schemas.method_facts import MethodFacts
from exceptiondrive_server.web.forms import made_document, read_form, texts_of

PREFIX = "fact_"
_OWN = tuple(replace(field, empty="not told") for field in fields_of(MethodFacts))
FACT_FIELDS = tuple(replace(field, name=PREFIX + field.name) for field in _OWN)


def facts_of_form(form: FormData) -> MethodFacts:
    """Return the facts that were typed.

    Raises:
        InvalidRecord: A value cannot be used; every field that is wrong is named.
    """
    values = read_form(FACT_FIELDS, form)
    return made_document(
        MethodFacts, _OWN, {field.name: values[PREFIX + field.name] for field in _OWN}
    )


def texts_of_facts(facts: MethodFacts) -> dict[str, str]:
    """Return what the fields show of facts."""
    return {PREFIX + name: text for name, text in texts_of(_OWN, facts).items()}
