"""The axes of a gateway: the axis files of one folder of its own, and no others."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from commissioning.ending import error_of
from commissioning.fleet.file import Keys
from commissioning.fleet.gateway.messages import FarAxis
from commissioning.fleet.loading import axis_in
from commissioning.fleet.plan import differences
from commissioning.journal import Journal
from drivers.link_text import is_simulated, is_stepped
from drivers.places import buses, same_place
from profiles.axis import Axis, axis_name
from profiles.errors import Refused, TwoRelayError, UnknownName, UsageError

__all__ = ["AxisFolder"]

_MOST = 1000  # files


class AxisFolder:
    """A folder of axis files, which are read anew each time: people change them."""

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise UsageError(f"{folder}: is no folder with axis files")
        self._folder = folder

    def files(self) -> Mapping[str, Path]:
        """Name → file: an axis of a gateway is called as its file is."""
        found: dict[str, Path] = {}
        for path in sorted(self._folder.glob("*.toml"))[:_MOST]:
            try:
                name = axis_name(path.stem)
            except ValueError:
                continue
            found[name] = path
        return found

    def faults(self) -> Iterator[str]:
        """What is wrong with its files, a line each."""
        files = self.files()
        if not files:
            yield f"no axis files in {self._folder}: NAME.toml with a link is the axis NAME"
        for name in files:
            try:
                self.axis(name, Keys())
            except TwoRelayError as error:
                yield str(error)

    def path(self, name: str) -> Path:
        """File of an axis; raises UnknownName."""
        path = self._folder / f"{name}.toml"
        with contextlib.suppress(ValueError):  # a name that leads elsewhere is none of here
            if axis_name(name) == path.stem and path.parent == self._folder and path.is_file():
                return path
        raise UnknownName(f"axis of this gateway ({self._folder})", name, list(self.files()))

    def axis(self, name: str, below: Keys) -> Axis:
        """An axis as its file says it, above the defaults of a fleet; raises UsageError."""
        axis = axis_in(self.path(name), below)
        return axis.model_copy(update={"name": name})

    def tell(self, names: tuple[str, ...], below: Keys, home: Path) -> Iterator[FarAxis]:
        """Each of these, as it is here."""
        with Journal(home, reading=True) as journal:
            for name in names:
                try:
                    axis = self.axis(name, below)
                except TwoRelayError as error:
                    yield FarAxis(name, error=error_of(error))
                else:
                    yield _told(axis, journal)

    def check_same(self, name: str, below: Keys, confirmed: str) -> Axis:
        """The axis, if it still is what was looked at and confirmed; raises Refused."""
        axis = self.axis(name, below)
        was = Axis.model_validate_json(confirmed)
        changed = list(differences(_said(was), _said(axis)))
        if changed:
            raise Refused(
                f"the file of axis '{name}' on its gateway differs from what was confirmed: "
                f"{'; '.join(changed[:3])}",
                code="refused.changed",
                hint="look at it, and begin again",
            )
        return axis


def _said(axis: Axis) -> dict[str, object]:
    return axis.model_dump(mode="json", exclude_unset=True)


def _told(axis: Axis, journal: Journal) -> FarAxis:
    link = axis.link
    assert link is not None
    runs = journal.unfinished_on(lambda other: same_place(link, other))
    return FarAxis(
        axis.name, axis.as_said(), buses(link), is_stepped(link), is_simulated(link),
        runs[0] if runs else None,
    )  # fmt: skip
