"""Every fault can be run without its injection, and a run without it does not count as survived."""

from tests.chaos.suite import FAULTS, run_fault
from tests.chaos.without import WITHOUT, fails_without


def test_every_fault_has_an_injection_that_can_be_taken_out() -> None:
    assert {name.split()[0] for name in WITHOUT} == {fault.id for fault in FAULTS}


def test_a_migration_that_nobody_kills_does_not_survive_its_fault() -> None:
    (fault,) = [fault for fault in FAULTS if fault.id == "F38"]
    assert run_fault(fault, None).is_survived
    outcome = fails_without("F38", fault)
    assert not outcome.is_survived
    assert "not killed" in outcome.text
