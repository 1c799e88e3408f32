"""The JSON Schema for editors says what the loader says."""

from __future__ import annotations

import json
import tomllib

import jsonschema
import pytest

from profiles.json_schema import json_schema
from profiles.library import builtin_names
from tests.command import ROOT

SCHEMA = json.loads((ROOT / "docs" / "profile.schema.json").read_text("utf-8"))


def test_the_file_is_what_the_schema_of_the_loader_makes() -> None:
    assert (
        json_schema() == SCHEMA
    )  # else: python -m profiles.json_schema > docs/profile.schema.json


@pytest.mark.parametrize("name", builtin_names())
def test_every_built_in_profile_is_valid(name: str) -> None:
    text = (ROOT / "profiles" / "builtin" / f"{name}.toml").read_text("utf-8")
    jsonschema.validate(tomllib.loads(text), SCHEMA)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('extends = "cia402"\nnonsense = 1\n', "nonsense"),
        ('extends = "cia402"\n[parameters.x]\ntrust = "maybe"\n', "maybe"),
        ('name = "x"\n', "required"),
    ],
)
def test_a_mistake_is_underlined(text: str, words: str) -> None:
    with pytest.raises(jsonschema.ValidationError, match=words):
        jsonschema.validate(tomllib.loads(text), SCHEMA)
