"""The codes of errors, reasons and refusals, from the source, as a page."""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict

from tests.house.source import modules

__all__ = ["page"]

_HEAD = """# Codes

Stable names for programs: `error.code` in a result's JSON, `quality.reasons[].code`, `why_not_code`
of gains. A sentence beside a code is for people, and may change; … is what is known only when
it happens. `usage` and `internal` end a command before, or outside of, a result.
This page is made from the source (`python -m tests.house.codes > docs/codes.md`).
"""
_LONGEST = 150  # characters of a sentence
_MEANT = {  # where the source has no sentence of its own
    "guardian.acted": "the guardian stopped the drive, and why",
    "internal": "a bug",
    "drive.fault": "the drive stopped by itself, or was stopped",
    "measurement.limit": "a limit ended an oscillation that need not be",
    "power.stuck": "the drive does not become enabled, or disabled, within its patience",
    "preflight.room": "no oscillation fits the travel; what would mend it",
    "restore.incomplete": "settings or values are not all back; which",
    "run.cut-off": "a run on this drive was cut off and left settings changed",
    "stop.energised": "the drive is still energised after a stop",
    "stop.not-verified": "the drive did not answer after a stop",
    "write.bus": "objects of the bus' own are not back; which",
}
_REFUSALS = "WhyNot", "CannotHold", "NotProposed"
_KINDS = "Reason", *_REFUSALS


def page() -> str:
    """docs/codes.md."""
    errors, reasons, refusals = _codes()
    parts = [
        _HEAD,
        "\n## Errors\n\n| code | error | exit | sentence |\n| --- | --- | --- | --- |\n",
    ]
    classes = _classes()
    for code, told in sorted(errors.items()):
        kinds = sorted({kind for kind, _ in told})
        exits = sorted({str(classes[kind][0]) for kind in kinds})
        parts.append(
            f"| `{code}` | {', '.join(kinds)} | {', '.join(exits)} | "
            f"{_MEANT.get(code) or _sentence(told)} |\n"
        )
    parts.append("\n## Reasons of a verdict\n\n| code | sentence |\n| --- | --- |\n")
    parts += [f"| `{code}` | {_sentence(told)} |\n" for code, told in sorted(reasons.items())]
    parts.append("\n## Why something is not done\n\n| code | sentence |\n| --- | --- |\n")
    parts += [f"| `{code}` | {_sentence(told)} |\n" for code, told in sorted(refusals.items())]
    return "".join(parts)


_Told = dict[str, list[tuple[str, str]]]


def _codes() -> tuple[_Told, _Told, _Told]:
    """Code → (class, sentence) of errors, of reasons, and of what is not done."""
    errors: _Told = defaultdict(list)
    reasons: _Told = defaultdict(list)
    refusals: _Told = defaultdict(list)
    classes = _classes()
    for kind, (_, code, doc) in classes.items():
        if code:
            errors[code].append((kind, doc))
    for tree in modules().values():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            name = node.func.id if isinstance(node.func, ast.Name) else ""
            given = next((k.value for k in node.keywords if k.arg == "code"), None)
            if name in classes and isinstance(given, ast.Constant):
                errors[given.value].append((name, _text(node.args[0])))
            elif name in (*_KINDS, "add", "_note") and node.args:
                first, last = node.args[0], node.args[-1]
                if isinstance(first, ast.Constant) and isinstance(first.value, str):
                    if name in _REFUSALS:
                        text = node.args[1]
                        refusals[first.value].append((name, _text(text)))
                    else:
                        reasons[first.value].append((name, _text(last)))
    return errors, reasons, refusals


def _classes() -> dict[str, tuple[int, str, str]]:
    """Exit code, own code and summary of every error class of the product."""
    found: dict[str, tuple[int, str, str]] = {"TwoRelayError": (1, "internal", "A bug.")}
    bases: dict[str, list[str]] = {}
    nodes: dict[str, ast.ClassDef] = {}
    for path, tree in modules().items():
        if not path.endswith("errors.py"):
            continue
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                nodes[node.name] = node
                bases[node.name] = [b.id for b in node.bases if isinstance(b, ast.Name)]

    def constant(name: str, key: str) -> ast.Constant | None:
        for line in nodes[name].body:
            if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == key:
                return line.value if isinstance(line.value, ast.Constant) else None
        above = [constant(base, key) for base in bases[name] if base in nodes]
        return next((value for value in above if value is not None), None)

    for name, node in nodes.items():
        own = any(
            isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "code"
            for line in node.body
        )
        code, exit_code = constant(name, "code"), constant(name, "exit_code")
        doc = (ast.get_docstring(node) or "").partition("\n")[0]
        if exit_code is not None:
            found[name] = int(str(exit_code.value)), str(code.value) if own and code else "", doc
    return found


def _text(node: ast.expr) -> str:
    """A sentence of the source, with … for what it is told."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(v) if isinstance(v, ast.Constant) else "…" for v in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _text(node.left) + _text(node.right)
    return "…"


def _sentence(told: list[tuple[str, str]]) -> str:
    """The longest of the sentences, cut at a word."""
    text = max((text for _, text in told), key=len)
    text = " ".join(re.sub(r"…(\s*…)+", "…", text).split()).replace("|", "\\|")
    if len(text) <= _LONGEST:
        return text
    return text[:_LONGEST].rpartition(" ")[0] + " …"


if __name__ == "__main__":
    sys.stdout.write(page())
