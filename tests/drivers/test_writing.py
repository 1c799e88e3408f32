"""May this be written? Every reason, its code, and which one is said first."""

from __future__ import annotations

import pytest

from drivers.described import Described, described
from drivers.scaling import Scaling
from drivers.writing import reasons_not_written, why_not_written
from profiles.axis import Mechanics
from profiles.library import load_profile
from profiles.parameter import Parameter, Protection, Trust, Unit

PROFILE = load_profile("virtual-canopen")
SCALING = Scaling(2.0, 4096, Mechanics())
PARAMETERS = described(PROFILE, SCALING, constant_known=True)


def changed(name: str, **update: object) -> Described:
    what = PARAMETERS[name]
    parameter: Parameter = what.parameter.model_copy(update=update)
    base = "6075h:00" if update.get("unit") is Unit.CURRENT else ""
    return Described(name, what.profile, parameter, what.unit, what.raw_unit, what.step, base)


def code(what: Described, *raw: int | None, **options: object) -> str:
    found = why_not_written(what, *raw, **options)  # type: ignore[arg-type]
    return "" if found is None else found.code


def test_what_may_be_written_has_no_reason() -> None:
    assert code(PARAMETERS["coulomb_positive"], 85, old=0) == ""
    assert code(PARAMETERS["max_torque"], 500, kind=Protection.EXPERIMENT) == ""
    assert code(PARAMETERS["controlword"], 6, is_command=True) == ""


@pytest.mark.parametrize(
    ("what", "raw", "options", "expected"),
    [
        (PARAMETERS["statusword"], 1, {}, "write.protected"),
        (PARAMETERS["controlword"], 15, {}, "write.protected"),
        (PARAMETERS["max_torque"], 1, {"kind": Protection.COMPENSATION}, "write.kind"),
        (changed("coulomb_positive", trust=Trust.UNVERIFIED), None, {}, "write.unverified"),
        (changed("coulomb_positive", unit=Unit.CURRENT), None, {}, "write.base"),
        (changed("coulomb_positive", minimum=0, maximum=9), 10, {}, "write.range"),
        (changed("coulomb_positive", forbidden=(3,)), 3, {}, "write.range"),
        (changed("coulomb_positive", maximum=9), 1, {"old": 10}, "write.no-way-back"),
        (changed("coulomb_positive", largest_step=5), 6, {"old": 0}, "write.step"),
    ],
)
def test_each_reason_has_its_code(
    what: Described, raw: int | None, options: dict[str, object], expected: str
) -> None:
    assert code(what, raw, **options) == expected


def test_a_setting_of_an_experiment_needs_no_trust() -> None:
    """It is put back; what stays in the drive must have been looked up."""
    assert code(changed("max_torque", trust=Trust.UNVERIFIED), 1) == ""


def test_a_reason_does_not_hide_the_others() -> None:
    what = changed("coulomb_positive", trust=Trust.UNVERIFIED, largest_step=5)
    assert [why.code for why in reasons_not_written(what, 6, 0)] == [
        "write.unverified", "write.step",
    ]  # fmt: skip


def test_what_nobody_has_verified_has_a_way_out() -> None:
    why = why_not_written(changed("coulomb_positive", trust=Trust.UNVERIFIED))
    assert why is not None
    assert "2310h" in why.text or PARAMETERS["coulomb_positive"].address in why.text
    assert "mark it verified in a copy of the profile" in why.hint
