"""What a Modbus unit is reached by: TCP, RTU over TCP, TLS, or a serial line."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import LinkError
from drivers.serial_port import SerialPort
from profiles.errors import UsageError
from profiles.files import contents

__all__ = ["LocalWire", "RtuLine", "TcpWire", "Tls", "Wire"]

_FAST = 19200  # baud, above which the silence no longer shrinks
_FAST_SILENCE = 0.00175  # s (Modbus over Serial Line V1.02, 2.5.1.1)


_LARGEST = 10_000_000  # bytes of a file with certificates
_NOT_BY_RFC_5280 = range(
    80, 95
)  # verification codes of OpenSSL for what only its strict mode refuses


def _no_password() -> str:
    raise ValueError("it has a password")


@dataclass(frozen=True, slots=True)
class Tls:
    """Certificates of a Modbus/TCP Security link (files in PEM).

    Parameters
    ----------
    authority : whose certificate the drive's must be signed by
    certificate, key : of this client, where the drive asks for one
    """

    authority: Path
    certificate: Path | None = None
    key: Path | None = None

    def wrap(self, plain: socket.socket, host: str) -> ssl.SSLSocket:
        """The socket under TLS; raises LinkError, UsageError."""
        try:
            context = self._context()
            return context.wrap_socket(plain, server_hostname=host)
        except UsageError:
            plain.close()
            raise
        except (OSError, ssl.SSLError) as error:
            plain.close()
            reason = getattr(error, "verify_message", "") or getattr(error, "reason", "") or error
            hint = "is it a Modbus/TCP Security port, and are the certificates for this drive?"
            if isinstance(error, ssl.SSLCertVerificationError):
                hint = f"is {self.authority} the authority that signed the drive's certificate?"
                if error.verify_code in _NOT_BY_RFC_5280:
                    hint = (
                        "the drive's certificate, or an authority's above it, is not made as RFC "
                        f"5280 wants it: have both issued anew (authority: {self.authority}), with "
                        "key identifiers, key usage and critical basic constraints"
                    )
            raise LinkError(f"no TLS with {host}: {reason}; {hint}", code="link.tls") from None

    def _context(self) -> ssl.SSLContext:
        """What is asked of a certificate on every Python alike: what 3.13 asks.

        Raises UsageError.
        """
        files = [("ca", self.authority), ("cert", self.certificate), ("key", self.key)]
        for option, path in files:
            try:
                if path is not None:
                    contents(path, _LARGEST)
            except OSError as error:
                raise UsageError(f"{option} {path}: cannot be read: {error.strerror}") from None
        try:
            context = ssl.create_default_context(cafile=str(self.authority))
        except (OSError, ssl.SSLError):
            raise UsageError(f"ca {self.authority}: holds no certificate in PEM") from None
        context.verify_flags |= ssl.VERIFY_X509_STRICT | ssl.VERIFY_X509_PARTIAL_CHAIN
        if self.certificate is None:
            return context
        try:
            context.load_cert_chain(self.certificate, self.key, password=_no_password)
        except (OSError, ssl.SSLError, ValueError) as error:
            key = f" and key {self.key}" if self.key is not None else ""
            raise UsageError(
                f"cert {self.certificate}{key}: are no certificate in PEM with its key, without a "
                f"password ({getattr(error, 'reason', None) or error})"
            ) from None
        return context


@dataclass(frozen=True, slots=True)
class TcpWire:
    """A TCP connection.

    `rtu`: a gateway that passes serial frames on; `tls`: under these certificates.
    """

    host: str
    port: int
    rtu: bool = False
    tls: Tls | None = None
    silence: float = 0.0  # s between two frames

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class RtuLine:
    """A serial line with Modbus RTU.

    Parameters
    ----------
    port : /dev/ttyUSB0 or COM5
    baudrate : bits a second
    parity : N, E or O
    stopbits : 1 or 2
    gap : s of silence between frames that the drive wants; 0: the standard's 3.5 characters
    stepping : behind it is a virtual drive that steps, which listens for no silence
    """

    port: str
    baudrate: int
    parity: str = "N"
    stopbits: int = 1
    gap: float = 0.0
    stepping: bool = False

    @property
    def character(self) -> float:
        """Time of one character, s: start, eight data bits, parity, stop."""
        bits = 1 + 8 + (self.parity != "N") + self.stopbits
        return bits / self.baudrate

    @property
    def silence(self) -> float:
        """Time between two frames, s."""
        if self.stepping:
            return 0.0
        standard = _FAST_SILENCE if self.baudrate > _FAST else 3.5 * self.character
        return max(standard, self.gap)

    def opened_as(self, timeout: float) -> SerialPort:
        """The port under this line, with `timeout` (s) for a read and a write."""
        return SerialPort(
            self.port, self.baudrate, self.parity, self.stopbits, timeout, write_timeout=timeout
        )

    def __str__(self) -> str:
        return f"{self.port} at {self.baudrate} baud 8{self.parity}{self.stopbits}"


@dataclass(frozen=True, slots=True)
class LocalWire:
    """No wire: a unit in this process, which takes requests and gives answers, with MBAP.

    Parameters
    ----------
    answers : bytes that were sent → what comes back for them
    """

    answers: Callable[[bytes], bytes]
    rtu: bool = False
    silence: float = 0.0

    def __str__(self) -> str:
        return "its twin in this process"


Wire = TcpWire | RtuLine | LocalWire
