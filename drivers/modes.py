"""Modes of operation: which the drive supports, how it is told one, and the set-point of each."""

from __future__ import annotations

import contextlib
from typing import Never

from drivers import cia402
from drivers.access import RawAccess
from drivers.described import Described, Parameters
from drivers.errors import NoAnswer, PreflightRefused, WriteDenied
from profiles.procedures import Mode, ModeCode

__all__ = ["Modes", "SetPoint"]


class Modes:
    """The modes of one drive."""

    def __init__(self, access: RawAccess) -> None:
        self._access = access
        self._profile = access.profile

    def supported(self, mode: Mode) -> ModeCode:
        """The code of `mode` that the drive has; raises PreflightRefused."""
        codes = self._profile.modes.get(mode, ())
        if not codes and mode is Mode.TORQUE:
            raise PreflightRefused(
                f"{self._profile} has no torque command, so no relay experiment can be run: record "
                "a motion with the drive's own software, and give it to 'tworelay analyze FILE "
                "--for AXIS'",
                code="mode.no-torque",
            )
        if not codes:
            raise PreflightRefused(f"{self._profile} has no {mode} mode", code="mode.none")
        bits = self._access.optional("supported_modes")
        if bits is None:
            return codes[0]
        for code in codes:
            if code.supported_bit is None or bits >> code.supported_bit & 1:
                return code
        wanted = " or ".join(str(code.code) for code in codes)
        raise PreflightRefused(
            f"the drive supports no {mode} mode: supported modes {bits:08X}h lack mode {wanted}",
            code="mode.unsupported",
        )

    def set(self, code: int) -> None:
        """Tell the drive its mode, and see that it takes it; raises PreflightRefused, LinkError."""
        patience = self._profile.patience.mode
        self.write(code)
        # a drive may have one register for both
        both = "mode_display" not in self._profile.parameters
        shown = "mode_of_operation" if both else "mode_display"
        if self._access.comes(lambda: self._access.read(shown) == code, patience):
            return
        raise PreflightRefused(
            f"the drive stays in mode {self._access.read(shown)} instead of {code} for "
            f"{patience:g} s; if it needs longer, say so in its profile: [patience] mode",
            code="mode.not-taken",
            wanted=code,
        )

    def write(self, code: int) -> None:
        """Tell the drive its mode; to some that of before is an error, or any while HALT is set."""
        access, bus = self._access, self._access.bus
        address = access.parameter("mode_of_operation").address
        if access.patiently(lambda: bus.read(address)) == code:
            return
        try:
            with contextlib.suppress(NoAnswer):  # the mode display tells
                bus.write(address, code)
        except WriteDenied as error:
            control = self._profile.parameters.get("controlword")
            if not error.busy:
                raise WriteDenied(
                    f"{error}; has this drive mode {code}? (6502h, and [[modes]] of its profile)"
                ) from None
            if self._profile.power is not None or control is None:
                raise
            access.patiently(lambda: bus.write(control.address, cia402.DISABLE_VOLTAGE))
            access.patiently(lambda: bus.write(address, code))


class SetPoint:
    """The set-point of one mode, in the cycle.

    Attributes
    ----------
    name : of its parameter
    at : where it is in `cycle.out`
    step : SI value of one raw step
    lowest, highest : raw
    """

    def __init__(
        self, mode: Mode, code: ModeCode, parameters: Parameters, access: RawAccess
    ) -> None:
        out = access.profile.cycle.out
        if code.set_point not in out:
            raise PreflightRefused(
                f"{access.profile} does not exchange '{code.set_point}' in its cycle",
                code="mode.not-in-cycle",
            )
        self.mode = mode
        self.name = code.set_point
        self._what: Described = parameters[code.set_point]
        self.address = self._what.parameter.address
        self.at = out.index(code.set_point)
        self.step = self._what.step
        self.lowest, self.highest = self._what.parameter.range

    def check(self, raw: int) -> None:
        """Raises PreflightRefused for what does not fit: nothing like it goes onto the wire."""
        if not self.lowest <= raw <= self.highest:
            self.refuse(raw)

    def refuse(self, raw: int) -> Never:
        """Raises PreflightRefused: `raw` does not fit."""
        step, unit, low, high = self.step, self._what.unit, self.lowest, self.highest
        raise PreflightRefused(
            f"{raw * step:.4g} {unit} is {raw} of '{self.name}' ({self.address}), which takes "
            f"{low:.0f}…{high:.0f}, that is {low * step:.4g}…{high * step:.4g} {unit}: is its "
            f"scale right in profile '{self._what.profile}', and are gear, rated_torque and "
            "encoder in the axis file?",
            code="set-point.range",
            parameter=self.name,
            value=raw,
            lowest=low,
            highest=high,
        )
