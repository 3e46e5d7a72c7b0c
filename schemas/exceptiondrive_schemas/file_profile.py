"""The profile of a planning file, compared with the recorded drives: numbers, and their wording."""

from exceptiondrive_schemas.base import Document

CONVERT = "`exceptiondrive convert FILE"
"""Beginning of a mend; options and a closing backtick follow."""
TOO_SLOW = 0.5
"""Below this share of the recorded speed the sources look too slow; the slowest of the 13 planners
of LightEMMA has 0.83."""


class Mend(Document):
    """A simple mistake that explains the file, and what mends it.

    Errors are median distances of the sources from the recorded drive as shares of its distance from
    the origin, or where `is_sideways`, of their ends alone, to the side; None where the trajectories
    tell the mistake by themselves.
    """

    looks_like: str
    convert_option: str | None
    """What `exceptiondrive convert` needs to mend the file; None where the planner has to."""
    error: float | None = None
    """As the file is."""
    mended_error: float | None = None
    """Mended."""
    is_sideways: bool = False
    """Whether both are measured to the side at the ends of turns, as of a mirror image."""
    by_hand: str | None = None
    """What the planner's author does, where no conversion can mend the file."""

    @property
    def sentence(self) -> str:
        """Description, with both errors and the mend."""
        if self.convert_option:
            cure = f"mend it by {CONVERT} {self.convert_option}`"
        else:
            cure = ": ".join(filter(None, ("no conversion can mend that", self.by_hand)))
        return f"The file looks like {self.looks_like}{self._fit_text}; {cure}."

    @property
    def _fit_text(self) -> str:
        if self.error is None or self.mended_error is None:
            return ""
        as_is = "" if self.error == self.mended_error else f", {self.error:.0%} as they are"
        of = "way to the side at the end of turns" if self.is_sideways else "driven distance"
        return f": taken so, the sources are {self.mended_error:.0%} of the {of} off the recorded drives{as_is}"


class FileProfile(Document):
    """What a planning file looks like; fields are None where there is nothing to tell them from.

    The distances need the recorded drives, which a manifest carries where they are public.
    """

    source_speed_mps: float | None = None
    """Median over the source trajectories."""
    recorded_speed_mps: float | None = None
    standing_sources: float | None = None
    """Share of the source trajectories that end where they begin."""
    standing_edited: float | None = None
    equal_pairs: float | None = None
    """Share of pairs whose two trajectories are alike."""
    same_edited: float | None = None
    """Share of the edited trajectories that are one path: as long, ending as far ahead, begun alike;
    None where they are few or short."""
    longer_sources: float | None = None
    """Share of pairs whose source is the longer one."""
    source_l2_m: float | None = None
    """Distance of the sources from the recorded drive: over all waypoints, mean over samples."""
    source_l2_1s_m: float | None = None
    source_l2_2s_m: float | None = None
    source_l2_3s_m: float | None = None
    median_source_l2_m: float | None = None
    """The same, median over samples: a few wild answers do not move it."""
    mend: Mend | None = None
    """What the file was probably meant to be; a warning, never a fault."""

    @property
    def lines(self) -> tuple[tuple[str, str], ...]:
        """The known facts, as a label and a few words each."""
        told = (
            ("source speed", self._speeds_text),
            ("source L2", self._distances_text),
            (
                "standing still",
                _shares_text(("sources", self.standing_sources), ("edited", self.standing_edited)),
            ),
            ("equal pairs", _shares_text(("source and edited alike", self.equal_pairs))),
            ("longer source", _shares_text(("the source is the longer one", self.longer_sources))),
        )
        return tuple((label, words) for label, words in told if words)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Probable mistakes in the file, as sentences."""
        if self.mend is not None:
            return (self.mend.sentence,)
        slow = (self.source_speed_mps or 0.0) < TOO_SLOW * (self.recorded_speed_mps or 0.0)
        return (f"The sources look too slow: {self._speeds_text}.",) if slow else ()

    @property
    def _speeds_text(self) -> str:
        if self.source_speed_mps is None:
            return ""
        recorded = self.recorded_speed_mps
        beside = "" if recorded is None else f", recorded {recorded:.2f} m/s"
        return f"median {self.source_speed_mps:.2f} m/s{beside}"

    @property
    def _distances_text(self) -> str:
        at = (
            ("at 1 s", self.source_l2_1s_m),
            ("at 2 s", self.source_l2_2s_m),
            ("at 3 s", self.source_l2_3s_m),
            ("mean", self.source_l2_m),
            ("median", self.median_source_l2_m),
        )
        return ", ".join(f"{what} {metres:.2f} m" for what, metres in at if metres is not None)


def _shares_text(*shares: tuple[str, float | None]) -> str:
    return ", ".join(f"{what} {share:.1%}" for what, share in shares if share is not None)
