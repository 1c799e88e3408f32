"""How a module of ours begins in a process of its own.

By its file, so that nothing else is taken for it.

Run as a script, before anything of ours is imported.
"""

from __future__ import annotations

import os.path
import sys
from importlib.util import find_spec

__all__ = ["main", "shadow"]

_PACKAGES = "commissioning", "drivers", "profiles"


def shadow(root: str) -> str:
    """What hides a package of ours, which lie in the folder `root`, in words.

    '' when nothing does.
    """
    for name in _PACKAGES:  # without pathlib, which a `--help` would wait for
        ours = os.path.join(root, name)  # noqa: PTH118
        spec = find_spec(name)
        where = (
            None
            if spec is None
            else spec.origin or next(iter(spec.submodule_search_locations or ()), None)
        )
        if where is None:
            return f"tworelay's own package '{name}' is not in {root}: install it again"
        if os.path.dirname(os.path.realpath(where)) not in (ours, root):  # noqa: PTH120
            return (
                f"{where} hides tworelay's own package '{name}' ({ours}): rename it, start in "
                "another folder, or take its folder out of PYTHONPATH"
            )
    return ""


def main() -> int:
    """`child.py ROOT MODULE ARGUMENTS`: the module of ours with its arguments."""
    root, module, *arguments = sys.argv[1:]
    if root not in sys.path:
        sys.path.insert(0, root)
    hidden = shadow(root)
    if hidden:
        sys.stdout.write(f"{hidden}\n")
        return 2
    import runpy

    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name="__main__", alter_sys=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
