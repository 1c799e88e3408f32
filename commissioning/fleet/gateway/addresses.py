"""Where the gateways of a fleet file are, and with which keys they are talked to."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import ssl
from pathlib import Path

from commissioning.fleet.gateway.keys import EXTRA, context, the_one
from commissioning.fleet.gateway.lines import Opened
from commissioning.fleet.gateway.messages import Wire
from commissioning.fleet.plan import Fleet
from drivers.errors import LinkError
from drivers.home import home
from profiles.errors import Refused, TwoRelayError, UsageError

__all__ = ["host_and_port", "keys_folder", "opener", "probe"]

_PROBE = 5.0  # s
_NOT_MINE = {  # alerts of TLS: what a gateway says that does not take our certificate
    "UNKNOWN_CA": "it does not know the authority (ca.crt) of this computer's certificate",
    "CERTIFICATE_EXPIRED": "this computer's certificate has expired there",
    "UNSUPPORTED_CERTIFICATE": "this computer's certificate is not that of a client",
    "BAD_CERTIFICATE": "it refuses this computer's certificate",
    "CERTIFICATE_REQUIRED": "it asks for a certificate",
}


def host_and_port(address: str) -> tuple[str, int]:
    """Of tls://HOST:PORT."""
    host, _, port = address.removeprefix("tls://").rpartition(":")
    return host.strip("[]"), int(port)


def keys_folder(fleet: Path, said: str | None) -> Path:
    """As the fleet file says, beside it; else 'keys' beside it, or in the home."""
    if said is not None:
        try:
            return fleet.parent / Path(said).expanduser()
        except RuntimeError:
            raise UsageError(f"keys = '{said}': there is no such user") from None
    beside = fleet.parent / "keys"
    return beside if beside.is_dir() else home() / "keys"


def opener(fleet: Fleet) -> Opened:
    """What opens a line to a gateway of this fleet; raises UsageError where that cannot be done."""
    try:
        from commissioning.fleet.gateway.engine import open_line
    except ImportError:
        raise UsageError(EXTRA) from None
    contexts: dict[str, ssl.SSLContext | TwoRelayError] = {}
    for name, gateway in fleet.gateways.items():
        try:
            _, files = the_one(keys_folder(fleet.path, gateway.keys), "client")
            contexts[name] = context(files, "client")
        except TwoRelayError as error:
            contexts[name] = error

    async def opened(name: str) -> Wire:
        found = contexts[name]
        if isinstance(found, TwoRelayError):
            raise found
        address = fleet.gateways[name].address
        await probe(name, address, found)
        return await open_line(name, address, found)

    return opened


async def probe(name: str, address: str, tls: ssl.SSLContext) -> None:
    """See whether there is a gateway of that name that takes us; raises LinkError, Refused."""
    where = f"gateway '{name}' at {address.removeprefix('tls://')}"
    host, port = host_and_port(address)
    try:
        async with asyncio.timeout(_PROBE):
            reader, writer = await asyncio.open_connection(
                host, port, ssl=tls, server_hostname=name
            )
            try:
                if not await reader.read(1):  # a refusal comes only now, in TLS 1.3
                    raise LinkError(f"{where}: it hangs up", code="gateway.refused")
            finally:
                writer.close()
                with contextlib.suppress(OSError):
                    await writer.wait_closed()
    except ssl.SSLCertVerificationError as error:
        raise Refused(
            f"{where}: its certificate is not taken: {error.verify_message.rstrip('.')}",
            code="gateway.certificate",
            hint="is it the right computer, and is ca.crt the same on both? A certificate that is "
            "not valid yet, or no more, may be a clock that is set wrongly",
        ) from None
    except ssl.SSLError as error:
        said = error.reason or str(error)
        why = next((text for mark, text in _NOT_MINE.items() if mark in said), f"TLS fails: {said}")
        raise Refused(
            f"{where}: {why}", code="gateway.certificate",
            hint="'tworelay fleet keys' makes certificates of one authority",
        ) from None  # fmt: skip
    except (UnicodeError, ValueError) as error:
        raise UsageError(f"{where}: is no address ({error})") from None
    except TimeoutError:
        raise LinkError(f"{where}: no answer in {_PROBE:.0f} s", code="gateway.lost") from None
    except OSError as error:
        raise LinkError(
            f"{where}: cannot be reached ({_why(error)})",
            code="gateway.lost",
            hint=f"is 'tworelay fleet gateway' running there, and does it --listen on port {port}?",
        ) from None


def _why(error: OSError) -> str:
    """In the system's words, and not in those of asyncio."""
    known = error.errno is not None and not isinstance(error, socket.gaierror)
    return (
        os.strerror(error.errno)
        if known and error.errno
        else error.strerror or str(error) or "it does not speak TLS"
    )
