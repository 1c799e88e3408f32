"""A compensation law: what each term is given, and of which a share can be tried."""

from __future__ import annotations

import re

import pytest

from profiles.law import Amount, Compensation, CompensationLaw, TablePoint

AMOUNT = Amount(coulomb=0.8, offset=0.1, viscous=0.02, share="80 %", motor_speed=0.5)
law_of = {str(law): law for law in CompensationLaw}.__getitem__
LAWS: dict[CompensationLaw, dict[str, object]] = {
    CompensationLaw.NONE: {},
    CompensationLaw.HOST: {"host": "h"},
    CompensationLaw.OFFSET_ASYMMETRIC: {"positive": "p", "negative": "n", "offset": "o"},
    CompensationLaw.SINGLE_GAIN: {"gain": "g"},
    CompensationLaw.SATURATED_LINEAR: {"gain": "g", "speed": "s", "offset": "o"},
    CompensationLaw.COULOMB_VISCOUS: {
        "positive": "p", "negative": "n", "viscous": "b", "offset": "o",
    },
    CompensationLaw.SPRING_STATIC_DYNAMIC: {
        "static": "f", "spring": "c", "dynamic": "b", "offset": "o",
    },
    CompensationLaw.LEVELS: {
        "offset": "o",
        "table": (TablePoint(speed="s1", torque="t1", at=2.0),
                  TablePoint(speed="s2", torque="t2", at=10.0)),
    },
    CompensationLaw.TABLE: {
        "points": "k",
        "table": (TablePoint(speed="s1", torque="t1", at=2.0),
                  TablePoint(speed="s2", torque="t2", at=10.0)),
    },
}  # fmt: skip
# by hand from what each law adds to the torque (reference: compensation laws)
VALUES = {
    CompensationLaw.NONE: {},
    CompensationLaw.HOST: {},
    CompensationLaw.OFFSET_ASYMMETRIC: {"o": 0.1, "p": 0.8, "n": 0.8},
    CompensationLaw.SINGLE_GAIN: {"g": 0.8},
    CompensationLaw.SATURATED_LINEAR: {"o": 0.1, "g": 0.8},  # the speed stays the drive's
    CompensationLaw.COULOMB_VISCOUS: {"o": 0.1, "p": 0.8, "n": 0.8, "b": 0.02},
    CompensationLaw.SPRING_STATIC_DYNAMIC: {"o": 0.1, "f": 0.8, "b": 0.02},
    # a level holds from the speed of the one below to its own: friction in the middle of that
    CompensationLaw.LEVELS: {
        "o": 0.1, "s1": 1.0, "t1": 0.8 + 0.02 * 0.5, "s2": 5.0, "t2": 0.8 + 0.02 * 3.0,
    },
    CompensationLaw.TABLE: {
        "s1": 1.0, "t1": 0.8 + 0.02 * 1.0, "s2": 5.0, "t2": 0.8 + 0.02 * 5.0, "k": 2.0,
    },
}  # fmt: skip
FRICTION = {
    CompensationLaw.NONE: set(),
    CompensationLaw.HOST: set(),
    CompensationLaw.OFFSET_ASYMMETRIC: {"p", "n"},
    CompensationLaw.SINGLE_GAIN: {"g"},
    CompensationLaw.SATURATED_LINEAR: {"g"},
    CompensationLaw.COULOMB_VISCOUS: {"p", "n", "b"},
    CompensationLaw.SPRING_STATIC_DYNAMIC: {"f", "b"},
    CompensationLaw.LEVELS: {"t1", "t2"},
    CompensationLaw.TABLE: {"t1", "t2"},
}


@pytest.mark.parametrize("law", CompensationLaw)
def test_what_a_law_is_given(law: CompensationLaw) -> None:
    found = Compensation.model_validate({"law": law, **LAWS[law]})
    values = {name: wanted.value for name, wanted in found.values(AMOUNT).items()}
    assert values == pytest.approx(VALUES[law])
    assert found.friction == FRICTION[law]


def test_a_linear_zone_may_have_a_torque_for_each_direction() -> None:
    law = Compensation(
        law=CompensationLaw.SATURATED_LINEAR, offset="o", positive="p", negative="n", speed="s"
    )
    assert {k: v.value for k, v in law.values(AMOUNT).items()} == {"o": 0.1, "p": 0.8, "n": 0.8}


@pytest.mark.parametrize(
    ("law", "terms", "said"),
    [
        # the terms of another law: it is named
        ("offset+asymmetric", "positive negative speed", "the terms of 'saturated-linear'"),
        ("single-gain", "gain speed", "the terms of 'saturated-linear'"),
        ("offset+asymmetric", "positive negative viscous", "the terms of 'coulomb+viscous'"),
        # of no law: what is missing, or one too many
        ("saturated-linear", "positive speed", "needs negative"),
        ("saturated-linear", "gain", "needs speed"),
        ("offset+asymmetric", "gain positive negative", "names gain, too"),
    ],
)
def test_terms_that_are_not_the_laws_say_which_law_they_are(
    law: str, terms: str, said: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        Compensation.model_validate({"law": law_of(law)} | dict.fromkeys(terms.split(), "x"))


def test_the_negative_direction_may_be_stored_with_its_sign() -> None:
    law = Compensation(
        law=CompensationLaw.OFFSET_ASYMMETRIC, positive="p", negative="n", negative_sign=-1
    )
    assert law.values(AMOUNT)["n"].value == -0.8


def test_what_is_not_known_is_not_written() -> None:
    law = Compensation.model_validate(
        {"law": CompensationLaw.COULOMB_VISCOUS, **LAWS[CompensationLaw.COULOMB_VISCOUS]}
    )
    unknown = AMOUNT._replace(offset=None, viscous=None)
    assert set(law.values(unknown)) == {"p", "n"}


def test_each_term_says_which_share_it_is() -> None:
    law = Compensation(law=CompensationLaw.SINGLE_GAIN, gain="g")
    assert law.values(AMOUNT)["g"].why == "80 % of the Coulomb friction"
