"""Commands for phases: create, show, change, freeze, reveal.

The options of the settings are made from `PhaseSettings`: a further field is a further option.
"""

from collections.abc import Callable, Mapping
from inspect import Parameter, signature
from pathlib import Path
from textwrap import shorten
from typing import Annotated, Any

import typer

from exceptiondrive.cli import completion, options
from exceptiondrive.cli.completion import choices
from exceptiondrive.cli.options import argument, one_of, option
from exceptiondrive.cli.output import Answer, be_sure, save_new, say
from exceptiondrive.cli.session import with_organizer
from exceptiondrive.cli.tables import records_table
from exceptiondrive.errors import InvalidArgumentError, utc_text
from exceptiondrive.organizer import Organizer
from exceptiondrive_schemas.api.form_fields import FormField, document_of, fields_of, values_of
from exceptiondrive_schemas.api.phase_settings import PhaseChange, PhaseSettings
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.printable import counted

PhaseArgument = Annotated[str, argument("ID", "Id of the phase.", offer=completion.phases)]
LONGEST_SHOWN = 100
"""Characters of a text that `show` prints; `--json` prints all."""
REVEALED = {
    "board": "the newest board of {} is shown, and from now on each that follows",
    "names": "teams and methods of {} appear under their names from its next board on",
    "split": "Scoring of {} has begun; readers do not see it. Continue with: organizer rescore status, preview "
    "and apply --preview DIGEST. The board changes when you apply.",
}
"""What `reveal` may show, and what it says then."""


@with_organizer
def show_phase(organizer: Organizer, phase_id: PhaseArgument) -> Answer:
    """Show the settings and the state of a phase."""
    phase = organizer.phase(phase_id)
    lines = _setting_lines(phase)
    width = max(len(key) for key in lines)
    return phase, *(f"{key:<{width}}  {_value_text(value)}" for key, value in lines.items())


@with_organizer
def create(
    organizer: Organizer,
    phase_id: Annotated[str, argument("ID", "Used in addresses.")],
    split: Annotated[
        str | None,
        option("--split", "NAME", "See `organizer splits list`; else that of --like."),
    ] = None,
    split_revision: Annotated[
        str | None,
        option("--split-revision", "REVISION", "Else that of --like, or the one registered last."),
    ] = None,
    challenge: Annotated[
        str | None,
        one_of("--challenge", CHALLENGES, "Else that of --like, or planning.", "C"),
    ] = None,
    protocol: Annotated[
        str | None, option("--protocol", "V", "Version or digest; else the default.")
    ] = None,
    like: Annotated[
        str | None,
        option(
            "--like",
            "ID",
            "Copy the settings of this phase, but not its dates.",
            offer=completion.phases,
        ),
    ] = None,
    **settings: Any,
) -> Answer:
    """Create a phase."""
    given = setting_document(PhaseSettings, settings)
    model = {} if like is None else organizer.phase(like)
    split, challenge = split or model.get("split"), challenge or model.get("challenge", "planning")
    if split is None:
        raise InvalidArgumentError("no_split", "A phase needs a split.", "Add --split or --like.")
    taken_over = _reusable_settings(model) if model else {}
    if model.get("split") == split:
        taken_over |= {key: model[key] for key in ("protocol", "split_revision")}
    wanted = {
        "id": phase_id,
        "split": split,
        "challenge": challenge,
        **_deep_merged(taken_over, given),
    }
    named = {"split_revision": split_revision, "protocol": protocol}
    wanted |= {key: value for key, value in named.items() if value is not None}
    phase = organizer.create_phase(wanted)
    notes = [f"its teams are told: {words}" for words in phase.get("not_checked", ())]
    if not phase["is_open"]:
        notes.append("it accepts no files now: check its dates and visibility")
    limits = f"protocol {phase['protocol']}, quota {phase['quota_per_day']} a day"
    if phase.get("quota_total") is not None:
        limits += f", {phase['quota_total']} in all"
    made = f"phase {phase['id']} created, {phase['now']['n_counted']} samples, {limits}"
    return phase, made, *notes


@with_organizer
def update(organizer: Organizer, phase_id: PhaseArgument, **settings: Any) -> Answer:
    """Change settings of a phase; a change that would break a promise is refused."""
    changes = setting_document(PhaseSettings, settings)
    if not changes:
        raise InvalidArgumentError(
            "nothing_to_set", "Say what to change: `--help` lists the settings."
        )
    before = _setting_lines(organizer.phase(phase_id))
    phase = organizer.change_phase(phase_id, changes)
    changed = {
        key: value for key, value in _setting_lines(phase).items() if value != before.get(key)
    }
    words = (
        f"{key}: {_value_text(before.get(key))} -> {_value_text(changed[key])}" for key in changed
    )
    return phase, *(words if changed else ("nothing changed",))


@with_organizer
def feature(organizer: Organizer, phase_id: PhaseArgument, reason: options.Reason) -> Answer:
    """Put a phase before all others: in lists, and on the front page."""
    phase = organizer.feature_phase(phase_id, reason)
    return phase, f"phase {phase_id} now comes before all others"


@with_organizer
def delete(organizer: Organizer, phase_id: PhaseArgument, reason: options.Reason) -> Answer:
    """Delete a phase in which nothing was submitted or rescored; archive or hide others instead."""
    phase = organizer.delete_phase(phase_id, reason)
    return phase, f"phase {phase['id']} deleted"


@with_organizer
def export(organizer: Organizer, phase_id: PhaseArgument, output: options.Output = None) -> Answer:
    """Download what readers may see of a phase, as a tar for a paper or an archive."""
    data = organizer.export_phase(phase_id)
    return save_new(output or Path(f"exceptiondrive-{phase_id}.tar"), data)


@with_organizer
def list_reported(organizer: Organizer, phase_id: PhaseArgument) -> Answer:
    """List the external boards beside a phase, withdrawn ones too, newest first."""
    found = organizer.reported_boards(phase_id)
    lines = [{**one, "n_rows": len(one["rows"])} for one in found]
    columns = ("id", "title", "n_rows", "imported_at", "withdrawn_at")
    return found, records_table(lines, columns)


@with_organizer
def import_reported(
    organizer: Organizer,
    phase_id: PhaseArgument,
    file: Annotated[
        Path,
        argument("FILE", "CSV, such as the one of a board; - is stdin."),
    ],
    title: Annotated[str, option("--title", "TEXT", "Name of the other board.")],
    cite: Annotated[str, option("--cite", "TEXT", "Where it is: address or citation.")],
) -> Answer:
    """Import the rows of another board beside a phase, unranked: all of them, or none."""
    text = options.given_file(file).text()
    made = organizer.import_reported(phase_id, text, title, cite)
    return made, f"{counted(len(made['rows']), 'row')} imported as {made['id']}, ranked nowhere"


@with_organizer
def withdraw_reported(
    organizer: Organizer,
    phase_id: PhaseArgument,
    reported_id: Annotated[str, argument("IMPORT", "Id of the import: see `reported`.")],
    reason: options.Reason,
) -> Answer:
    """Remove the rows of another board from a phase; they can be imported again."""
    gone = organizer.withdraw_reported(phase_id, reported_id, reason)
    return gone, f"{gone['title']} withdrawn"


@with_organizer
def freeze(organizer: Organizer, phase_id: PhaseArgument, reason: options.Reason) -> Answer:
    """Freeze the public board now; scoring goes on."""
    phase = organizer.freeze_phase(phase_id, reason)
    since = utc_text(phase["now"]["frozen_since"])
    reveal = f'organizer phases reveal {phase_id} --what board --reason "…"'
    return phase, f"the board of {phase_id} has been frozen since {since}; {reveal} ends the freeze"


@with_organizer
def reveal(
    organizer: Organizer,
    phase_id: PhaseArgument,
    what: Annotated[str, one_of("--what", REVEALED, "What to show readers.")],
    reason: options.Reason,
    yes: options.Yes = False,
) -> Answer:
    """Show the board behind a freeze or the names, or begin to score the other part of the split.

    Showing a board or names cannot be undone: both need --yes without a terminal.
    """
    options.require_one_of("--what", what, REVEALED)
    if what == "board" and organizer.phase(phase_id)["policy"]["frozen_scores"] == "hidden":
        say(
            "Once the deadline of the phase has passed, it can no longer move after this reveal, and later "
            f"deadlines of single teams end: {organizer.server}/organize/phases/{phase_id}/reveal-board names any."
        )
    if what != "split":  # which a run shows, and can take back
        be_sure(f"Reveal the {what} of {phase_id} for good?", yes)
    phase = organizer.reveal_phase(phase_id, what, reason)
    return phase, REVEALED[what].format(phase_id)


def with_settings(command: Callable[..., None], model: type[Document]) -> Callable[..., None]:
    """Return a command with an option for each setting of a model, such as `--quota-per-day N`."""
    *own, _ = signature(command).parameters.values()
    return options.with_parameters(command, [*own, *map(_setting_option, fields_of(model))])


def _setting_option(field: FormField) -> Parameter:
    name = "--" + field.name.replace("_", "-")
    default = Parameter.empty if field.is_required and field.default is None else None
    if field.kind == "yes":
        flag = typer.Option(f"{name}/--no-{name[2:]}", help=field.hint, show_default=False)
        return _parameter(field.name, Annotated[bool | None, flag], None)
    words = {
        "whole": f"{field.lowest}..{field.highest}",
        "moment": "TIME",
        "choice": "|".join(value for value, _ in field.options),
    }
    metavar = words.get(field.kind, "TEXT") + ("|none" if field.may_be_none else "")
    hint = f"{field.hint} `@FILE` reads it from a file." if field.kind == "lines" else field.hint
    values = [value for value, _ in field.options] + ["none"] * field.may_be_none
    offer = choices(*values) if field.kind == "choice" else None
    asked = option(name, metavar, hint, offer=offer)
    kind = str if default is Parameter.empty else str | None
    return _parameter(field.name, Annotated[kind, asked], default)


def _parameter(name: str, annotation: Any, default: Any) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def setting_document(model: type[Document], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a model that were given, as the API takes them."""
    fields = fields_of(model)
    said = {field.name: field for field in fields if given[field.name] is not None}
    return document_of(
        fields, {name: setting_value(field, given[name]) for name, field in said.items()}
    )


def _reusable_settings(phase: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a phase that another may take over: all but dates, position, and being archived."""
    known = PhaseSettings.model_validate(phase, extra="ignore")
    fields = [field for field in fields_of(PhaseSettings) if field.kind != "moment"]
    document = document_of(fields, values_of(fields, known))
    return {
        key: value
        for key, value in document.items()
        if key != "position" and (key, value) != ("visibility", "archived")
    }


def _deep_merged(document: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document with changes, also of the documents in it."""
    inner = {
        key: {**document[key], **changes[key]}
        for key in ("page", "policy")
        if key in document and key in changes
    }
    return {**document, **changes, **inner}


def setting_value(field: FormField, given: Any) -> Any:
    """Return what an option said, as the API takes it."""
    if given == "none" and field.may_be_none:
        return None
    if field.kind == "lines":
        return options.from_file(given)
    if field.kind == "whole":
        if not (given.isdecimal() and field.lowest <= int(given) <= field.highest):
            raise InvalidArgumentError(
                "wrong_value",
                f"{field.name} is a whole number from {field.lowest} to {field.highest:,}, "
                f"not {given!r}.",
            )
        return int(given)
    if field.options:
        options.require_one_of(field.name, given, (value for value, _ in field.options))
    return given


def _setting_lines(phase: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a phase and where it stands, by what a line calls them."""
    settings = {key: value for key, value in phase.items() if not isinstance(value, dict | list)}
    now = {f"now: {key}": value for key, value in phase["now"].items()}
    return {**settings, **phase["page"], **phase["policy"], **now}


def _value_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "-" if value in (None, "") else shorten(str(value), LONGEST_SHOWN, placeholder=" …")


COMMANDS: dict[str, Callable[..., None]] = {
    "create": with_settings(create, PhaseSettings),
    "show": show_phase,
    "update": with_settings(update, PhaseChange),
    "feature": feature,
    "delete": delete,
    "export": export,
    "reported": list_reported,
    "import-reported": import_reported,
    "withdraw-reported": withdraw_reported,
    "freeze": freeze,
    "reveal": reveal,
}
