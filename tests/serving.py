"""Virtual drives served to the tests.

`virtual serve` itself, in a process forked from a warm one.
"""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Generator
from multiprocessing.connection import Connection
from pathlib import Path

__all__ = ["WIRES", "serve"]

WIRES = {
    "modbus-tcp": ("--modbus-tcp", "127.0.0.1:0"),
    "modbus-rtu": ("--modbus-rtu", "pty"),
    "modbus-rtu-tcp": ("--modbus-rtu-tcp", "127.0.0.1:0"),
    "socketcand": ("--socketcand", "127.0.0.1:0"),
    "slcan": ("--slcan", "pty"),
}
_PATIENCE = 10.0  # s to end in
_WARM = [
    "commissioning.cli.virtual", "drivers.link", "drivers.virtual.serve", "drivers.virtual.twin",
    "drivers.virtual.modbus_server", "drivers.virtual.habitual_slave",
    "drivers.virtual.canopen_node",
    "profiles.library",
]  # fmt: skip

_CONTEXT = (
    multiprocessing.get_context("forkserver")
    if hasattr(os, "fork")
    else multiprocessing.get_context("spawn")
)
_CONTEXT.set_forkserver_preload(_WARM)


class _Lines(io.TextIOBase):
    """A standard output that sends each line to another process."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def write(self, text: str) -> int:
        if not isinstance(text, str):
            raise TypeError("this is a stream of text")
        for line in text.splitlines():
            self._connection.send(line)
        return len(text)


def _run(arguments: tuple[str, ...], connection: Connection, environment: dict[str, str]) -> None:
    from commissioning.cli import main

    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["tworelay", "virtual", "serve", *arguments]
    sys.stdout = _Lines(connection)
    main()


@contextlib.contextmanager
def serve(
    *arguments: str, links: int = 1, state: Path | None = None, several: bool = False
) -> Generator[list[str]]:
    """The first `links` LINKs of `tworelay virtual serve`.

    `state`: its non-volatile memory; `several` have theirs under TWORELAY_HOME.
    """
    reader, writer = _CONTEXT.Pipe(duplex=False)
    with tempfile.TemporaryDirectory() as folder:
        memory = () if several else ("--state", str(state or Path(folder) / "drive.json"))
        server = _CONTEXT.Process(
            target=_run, args=((*arguments, *memory), writer, dict(os.environ)), daemon=True
        )
        server.start()
        writer.close()
        try:
            yield [_line(reader) for _ in range(links)]
        finally:
            server.terminate()
            server.join(_PATIENCE)
            if server.exitcode is None:
                server.kill()
                server.join()
            code = server.exitcode
            server.close()
            reader.close()
        assert code == 143, f"it ends by its signal, and not by a bug ({code})"


def _line(reader: Connection) -> str:
    try:
        return str(reader.recv())
    except EOFError:
        raise AssertionError("the virtual drive did not start") from None
