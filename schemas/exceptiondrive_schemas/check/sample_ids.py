"""Checks that a file has every sample of the split once: unknown, missing and duplicate ids."""

import difflib
import re
from bisect import bisect
from collections.abc import Iterable, Sequence

from exceptiondrive_schemas.check.fault_list import FaultList, check_text, escaped, kind, quoted
from exceptiondrive_schemas.faults import MAX_EXAMPLES, FaultCode
from exceptiondrive_schemas.split import Manifest

NEIGHBOURS = 25
MAX_ID_CHARACTERS = 128
SIMILARITY = 0.75

FILE_NAME = re.compile(r"\.(?:jpe?g|png|webp|bmp|tiff?|json|npz?|pkl|pt|bin|pcd)$", re.IGNORECASE)
SHARDS = "one shard of several? `exceptiondrive convert FILE FILE ...` makes one file of them"


class NearestId:
    """Sorted valid ids; a search examines few of them, so that 50,000 cost no more than 50.

    A mistyped id still shares its beginning or its end with the right one, so it is near it in the
    order of the ids, or in the order of the reversed ids.
    """

    def __init__(self, valid_ids: Iterable[str]) -> None:
        self._forward = sorted(valid_ids)
        self._backward = sorted(valid_id[::-1] for valid_id in self._forward)
        self._valid = {valid_id.casefold(): valid_id for valid_id in self._forward}

    def nearest(self, wanted: str) -> str | None:
        """Return the valid id most similar to `wanted`, or None if none is similar."""
        if of_name := self._in_name(wanted):
            return of_name
        if len(wanted) > MAX_ID_CHARACTERS:
            return None
        near = _neighbours_of(self._forward, wanted)
        near += [valid_id[::-1] for valid_id in _neighbours_of(self._backward, wanted[::-1])]
        found = difflib.get_close_matches(wanted, near, n=1, cutoff=SIMILARITY)
        return found[0] if found else None

    def _in_name(self, wanted: str) -> str | None:
        """Return the valid id that differs in case only, or is the last part of a file's path."""
        parts = wanted[-2 * MAX_ID_CHARACTERS :].strip().casefold().replace("\\", "/").split("/")
        parts[-1] = parts[-1].partition(".")[0].partition("__")[0]
        names = ("/".join(parts[start:]) for start in range(len(parts)))
        return next((self._valid[name] for name in names if name in self._valid), None)


def _neighbours_of(ordered: list[str], wanted: str) -> list[str]:
    at = bisect(ordered, wanted)
    return ordered[max(at - NEIGHBOURS, 0) : at + NEIGHBOURS]


NO_LINE_BREAKS: frozenset[str] = frozenset()


class SampleIds:
    """The sample ids of a file so far. Without a manifest only duplicates can be found."""

    def __init__(self, manifest: Manifest | None, faults: FaultList) -> None:
        self._manifest = manifest
        self._valid = frozenset(manifest.sample_ids) if manifest else None
        self._faults = faults
        self._first_at: dict[str, int] = {}
        self._unknown: list[tuple[int, str]] = []

    def admit(self, value: object, index: int) -> str | None:
        """Check the `sample_id` of one prediction; return it if it is usable."""
        if not isinstance(value, str) or not value:
            got = "an empty text" if value == "" else kind(value)
            hint = "take the ids from the manifest; a number or a place in a list is none"
            self._add_fault(FaultCode.WRONG_TYPE, index, "a sample id in quotes", got, hint)
            return None
        if self._valid is None:
            return self._admit_once(value, index) if self._is_sound(value, index) else None
        if value not in self._valid:
            self._note_unknown(value, index)
            return None
        return self._admit_once(value, index)

    def are_sound(self, sample_ids: Sequence[str]) -> bool:
        """Whether these are certainly the ids of a sound file; then none is checked again."""
        distinct = set(sample_ids)
        if len(distinct) < len(sample_ids):
            return False
        if self._valid is not None:
            return distinct == self._valid
        return all(each.isprintable() and 0 < len(each) <= MAX_ID_CHARACTERS for each in sample_ids)

    def finish(self, n_read: int | None) -> None:
        """Report unknown and missing samples, each with the id that was probably meant.

        If no prediction names a sample of the split, that is said once, in place of all missing
        samples. If the list of predictions was not read to its end, and its length is unknown, no
        sample counts as missing.
        """
        if self._manifest is None:
            return
        missing = [each for each in self._manifest.sample_ids if each not in self._first_at]
        if self._unknown:
            nearest = NearestId(missing or self._manifest.sample_ids)
            self._report_unknown(self._manifest.name, nearest)
        if n_read is not None and (self._first_at or n_read == 0):
            self._report_missing(missing, NearestId(text for _, text in self._unknown))

    @property
    def are_of_another_split(self) -> bool:
        """Whether there are ids, and none of them is in the split."""
        return bool(self._unknown) and not self._first_at

    def _admit_once(self, value: str, index: int) -> str | None:
        first = self._first_at.setdefault(value, index)
        if first == index:
            return value
        got = f"{quoted(value)} also at $.predictions[{first}]"
        self._add_fault(
            FaultCode.DUPLICATE_SAMPLE, index, "every sample once", got, sample_id=escaped(value)
        )
        return None

    def _is_sound(self, value: str, index: int) -> bool:
        path = ("predictions", index, "sample_id")
        return check_text(
            value, path, self._faults, max_characters=MAX_ID_CHARACTERS, allowed=NO_LINE_BREAKS
        )

    def _note_unknown(self, value: str, index: int) -> None:
        if len(self._unknown) < MAX_EXAMPLES:
            self._unknown.append((index, value))
        else:
            self._faults.count(FaultCode.UNKNOWN_SAMPLE, [escaped(value)])

    def _report_unknown(self, name: str, valid: NearestId) -> None:
        for index, text in self._unknown:
            nearest = valid.nearest(text)
            hint = f"did you mean {quoted(nearest)}?" if nearest else None
            self._add_fault(
                FaultCode.UNKNOWN_SAMPLE,
                index,
                f"a sample id of the split {name}",
                quoted(text),
                hint,
                sample_id=escaped(text),
            )
        if self.are_of_another_split:
            are_files = all(FILE_NAME.search(text) for _, text in self._unknown)
            self._faults.say(
                FaultCode.UNKNOWN_SAMPLE,
                f"No sample id of the file belongs to the split {name}: "
                + (
                    "they look like names of images; write the ids of the split's manifest, without "
                    "folder and ending."
                    if are_files
                    else "take the ids from the split's manifest, or choose the phase that the file "
                    "was made for."
                ),
            )

    def _report_missing(self, missing: list[str], unknown: NearestId) -> None:
        is_a_part = (
            bool(self._first_at) and not self._unknown and len(missing) >= len(self._first_at)
        )
        for sample_id in missing[:MAX_EXAMPLES]:
            hint = SHARDS if is_a_part else None
            if nearest := unknown.nearest(sample_id):
                hint = f"the file has {quoted(nearest)}, which is no sample"
            self._faults.add(
                FaultCode.MISSING_SAMPLE,
                ("predictions",),
                expected=f"a prediction for {quoted(sample_id)}",
                got="none",
                sample_id=sample_id,
                hint=hint,
            )
        self._faults.count(FaultCode.MISSING_SAMPLE, missing[MAX_EXAMPLES:])

    def _add_fault(
        self,
        code: FaultCode,
        index: int,
        expected: str,
        got: str,
        hint: str | None = None,
        sample_id: str | None = None,
    ) -> None:
        path = ("predictions", index, "sample_id")
        self._faults.add(code, path, expected=expected, got=got, hint=hint, sample_id=sample_id)
