"""The report as a PDF: by fpdf2 and matplotlib, so that no browser is needed.

fpdf2 sets text, tables and page numbers, and takes the pictures as they are printed; what the
screen's report has in its theory stays there.
"""

from __future__ import annotations

import io
import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from fpdf import FPDF
from fpdf.enums import XPos, YPos

from commissioning.records import History
from commissioning.report import figures
from commissioning.report.quiet import quiet
from commissioning.report.words_of import foot_of, proofs_of
from commissioning.result import words
from commissioning.result.codec import printable
from commissioning.result.document import RunResult
from commissioning.result.found import QUANTITIES
from commissioning.result.language import said, speaking
from commissioning.samples import Samples
from profiles.errors import UsageError
from profiles.plain import plain

__all__ = ["PAPERS", "pdf_of"]

PAPERS = "a4", "letter"
_COLOURS = {"good": (30, 107, 43), "usable": (138, 90, 0), "rejected": (161, 22, 22)}
_TONES = {"good": (30, 107, 43), "doubt": (138, 90, 0), "bad": (161, 22, 22)}
_SOFT, _LINE = (92, 92, 92), (200, 200, 200)
_SMALL, _USUAL, _LARGE = 8, 9.5, 16  # points
_MARGIN = 15  # mm


class _Paper(FPDF):
    """Pages with a foot."""

    def __init__(self, foot: str, paper: str) -> None:
        super().__init__(format=paper)
        self._foot = foot
        fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
        for style, name in (("", "DejaVuSans.ttf"), ("B", "DejaVuSans-Bold.ttf")):
            self.add_font("text", style, fonts / name)
        self.set_margin(_MARGIN)
        self.set_auto_page_break(auto=True, margin=_MARGIN + 5)
        self.set_title(foot)
        self.set_creator("tworelay")

    def footer(self) -> None:
        """Run, version, operator, time; page."""
        self.set_y(-_MARGIN)
        self.set_font("text", size=6.5)
        self.set_text_color(*_SOFT)
        self.cell(self.epw * 0.85, 4, _fitting(self._foot, 120))
        self.cell(self.epw * 0.15, 4, f"{self.page_no()} / {{nb}}", align="R")

    def line_of(
        self,
        text: str,
        *,
        size: float = _USUAL,
        bold: bool = False,
        colour: tuple[int, int, int] = (0, 0, 0),
    ) -> None:
        """A paragraph."""
        self.set_font("text", "B" if bold else "", size)
        self.set_text_color(*colour)
        self.multi_cell(0, size * 0.5, plain(text), align="L", new_x=XPos.LMARGIN, new_y=YPos.NEXT)

    def heading(self, text: str, room: float = 40) -> None:
        """A heading that stays with the `room` mm that come after it."""
        if self.get_y() + room > self.h - 2 * _MARGIN:
            self.add_page()
        self.ln(4)
        self.line_of(text, size=11.5, bold=True)
        self.set_draw_color(*_LINE)
        self.line(self.l_margin, self.get_y() + 0.5, self.w - self.r_margin, self.get_y() + 0.5)
        self.ln(2)

    def rows(
        self,
        rows: Sequence[Sequence[str]],
        widths: Sequence[float],
        *,
        first_is_head: bool = True,
        right: Sequence[int] = (),
    ) -> None:
        """A table; `right`: columns of numbers."""
        self.set_font("text", size=_SMALL)
        self.set_text_color(0, 0, 0)
        self.set_draw_color(*_LINE)
        aligned = tuple("RIGHT" if n in right else "LEFT" for n in range(len(widths)))
        options: Any = {
            "col_widths": tuple(widths), "text_align": aligned, "line_height": 4.4, "padding": 0.7,
            "borders_layout": "HORIZONTAL_LINES", "first_row_as_headings": first_is_head,
        }  # fmt: skip
        with self.table(**options) as table:
            for row in rows:
                table.row([plain(cell) for cell in row])
        self.ln(1)

    def picture(self, figure: Any, height: float) -> None:
        """A figure, as wide as the page at most."""
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=170)
        stream.seek(0)
        if self.get_y() + height > self.h - _MARGIN - 8:
            self.add_page()
        self.image(stream, w=self.epw, h=height, keep_aspect_ratio=True)
        self.ln(1)


def _fitting(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"


def pdf_of(
    result: RunResult, samples: Samples | None, history: History, language: str, paper: str
) -> bytes:
    """The report as PDF; raises UsageError where its numbers make none."""
    result = printable(result)
    logging.getLogger("fpdf").setLevel(logging.ERROR)  # a letter that no font has is a box
    try:
        errors = np.errstate(divide="raise", invalid="raise", over="raise")
        with errors, quiet(), speaking(language):
            return _written(result, samples, history, paper)
    except (LookupError, ValueError, ArithmeticError) as error:
        raise UsageError(
            f"run {result.run}: its numbers make no PDF ({type(error).__name__}: {error})"
        ) from None


def _written(result: RunResult, samples: Samples | None, history: History, paper: str) -> bytes:
    created = time.strftime("%Y-%m-%d %H:%M %z", time.localtime(history.run.created))
    page = _Paper(foot_of(result, created), paper)
    page.add_page()
    _first_page(page, result, samples, created)
    _found(page, result)
    _in_the_drive(page, result)
    _proofs(page, result, samples)
    if samples is not None and len(samples) > 1:
        page.heading(said("The whole run"), 90)
        page.picture(figures.overview(samples, result.units), 70)
        page.rows(
            [[f"{at:.2f} s", text] for at, text in figures.stages(samples)], (1, 9),
            first_is_head=False,
        )  # fmt: skip
    return bytes(page.output())


def _first_page(page: _Paper, result: RunResult, samples: Samples | None, created: str) -> None:
    verdict, proof = result.quality.verdict, result.verification
    page.line_of(f"{said('Friction of')} {result.axis}", size=_LARGE, bold=True)
    page.line_of(f"{said('Run')} {result.run} · {created} · {result.link}", colour=_SOFT)
    page.ln(2)
    page.line_of(
        said(words.VERDICTS[verdict]).upper(), size=12, bold=True,
        colour=_COLOURS.get(verdict or "", (0, 0, 0)),
    )  # fmt: skip
    page.line_of(words.act_ended(result) + ".", bold=True, colour=_TONES[words.tone(result)])
    if result.error is not None:
        page.line_of(result.error.text)
    page.ln(2)
    rows = []
    if result.friction.coulomb:
        found = result.friction.coulomb
        there = words.counted(found)
        text = words.found_as(found) + (f", {there}" if there else "")
        rows.append([said("Coulomb friction"), text])
    gain = said("not proved")
    if proof is not None and proof.percent is not None:
        gain = f"{proof.percent:.0f} % {said('less error after reversals')}"
    rows.append([said("Improvement"), gain])
    rows.append([said("In the drive"), _there(result)])
    undo = f"tworelay restore {result.run}" if result.written else said("nothing to undo")
    rows.append([said("To undo it"), undo])
    who = result.identity
    named = (who.vendor, who.product, who.revision, who.serial) if who else ()
    drive = " ".join(text for text in named if text)
    rows.append([said("Drive"), drive or said("not identified")])
    if result.profile:
        rows.append([said("Profile"), f"{result.profile.name} {result.profile.version}"])
    page.rows(rows, (2.2, 7.8), first_is_head=False)
    if proof is not None and samples is not None:
        figure = figures.following(proof, samples.curves)
        if figure is not None:
            page.line_of(said("Before and after"), bold=True)
            page.picture(figure, 62)
            page.line_of(words.helps(proof), size=_SMALL, colour=_SOFT)
    for text in (*result.notes, *(reason.text for reason in result.quality.reasons)):
        page.line_of(f"– {text}", size=_SMALL)
    page.set_y(max(page.get_y() + 10, page.h - 42))
    page.set_font("text", size=_SMALL)
    page.set_text_color(*_SOFT)
    width = page.epw / 3 - 6
    for text in ("Name", "Date", "Signed"):
        page.cell(width, 5, said(text), border="T")
        page.cell(6, 5, "")
    page.add_page()


def _there(result: RunResult) -> str:
    if not result.written:
        return said("nothing of this run")
    told = [
        f"{one.parameter} {one.raw if one.value is None else words.si(one.value, one.unit)}"
        for one in result.written
    ]
    return f"{', '.join(told)} ({said('as of')} {result.ended})"


_NAMES = {
    "coulomb": "Coulomb friction, mean of both directions",
    "offset": "Offset: load, and half of what the directions differ",
    "viscous": "Viscous friction", "inertia": "Inertia", "dead_time": "Dead time",
}  # fmt: skip


def _found(page: _Paper, result: RunResult) -> None:
    page.heading(said("What was found"))
    rows = [[said("Quantity"), said("Value"), said("In the drive's unit")]]
    for key in QUANTITIES:
        quantity = result.friction.quantity(key)
        if quantity is not None:
            rows.append([said(_NAMES[key]), words.found_as(quantity), words.counted(quantity)])
    if len(rows) == 1:
        page.line_of(said("not measured"))
        return
    page.rows(rows, (4.6, 3.4, 2), right=(1, 2))
    if text := words.distorted(result):
        page.line_of(f"{text[0].upper()}{text[1:]}.", size=_SMALL)


def _in_the_drive(page: _Paper, result: RunResult) -> None:
    page.heading(said("What was written"))
    if not result.compensation:
        page.line_of(f"{said('Nothing')}: {words.nothing_proposed(result)}.")
    else:
        rows = [[said(name) for name in ("Parameter", "old", "new", "raw", "why", "state")]]
        for one in result.compensation:
            before = "?" if one.old_raw is None else str(one.old_raw)
            rows.append(
                [
                    one.parameter, "–" if one.old is None else words.si(one.old, one.unit),
                    words.si(one.new, one.unit), f"{before} → {one.new_raw}", one.why,
                    said(words.change_state(one, result)),
                ]
            )  # fmt: skip
        page.rows(rows, (2.2, 1.6, 1.7, 1.2, 2.2, 1.6), right=(1, 2, 3))
    proof = result.verification
    if proof is None:
        return
    page.heading(said("Does it help?"))
    page.line_of(words.helps(proof) + ".", bold=True)
    page.ln(1)
    heads = (
        "Compensation", "after reversals, peak", "at low speed, rms", "at rest, half-swing",
        "state",
    )  # fmt: skip
    rows = [[said(name) for name in heads]]
    for step in proof.steps:
        marks = [said("hunts")] * step.hunts + [said("stayed")] * step.kept
        rows.append(
            [
                f"{100 * step.fraction:g} %" if step.fraction else said("none"),
                words.si(step.reversal_error, proof.unit),
                words.si(step.low_speed_error, proof.unit),
                f"± {words.si(step.rest_swing, proof.unit)}", ", ".join(marks),
            ]
        )  # fmt: skip
    page.rows(rows, (2, 2.2, 2.2, 2.2, 1.4), right=(1, 2, 3))


def _proofs(page: _Paper, result: RunResult, samples: Samples | None) -> None:
    page.heading(said("Limits and safety proofs"))
    rows = []
    watched, units = result.experiment, result.units
    if watched is not None and watched.limits is not None:
        limits = watched.limits
        turning = f" ({words.rpm(limits.speed)})" if units.position == "rad" else ""
        rows.append(
            [
                said("Limits"),
                ", ".join(
                    (
                        f"±{words.both_ways(limits.travel, units.position)}",
                        words.si(limits.torque, units.effort),
                        f"{words.si(limits.speed, units.position + '/s')}{turning}",
                    )
                ),
            ]
        )
    if watched is not None:
        rows.append(
            [
                said("Experiment"),
                ", ".join(
                    (
                        words.si(watched.duration, "s"),
                        words.si(1000 * watched.cycle, "ms"),
                        words.both_ways(watched.travel, units.position),
                        f"{100 * watched.late_share:.2g} % {said('of cycles late')}",
                        f"{100 * watched.lost_share:.2g} % {said('lost')}",
                    )
                ),
            ]
        )
    proved = said("What was proved before anything moved fast")
    rows += [[proved if n == 0 else "", text] for n, text in enumerate(proofs_of(samples))]
    if rows:
        page.rows(rows, (3, 7), first_is_head=False)
