"""Who may command a gateway: a small certificate authority, and certificates of two roles.

A gateway's certificate serves and commands nobody; a client's commands and serves nobody. OpenSSL
itself holds either to its role, by the extended key usage.
"""

from __future__ import annotations

import ssl
import stat
import sys
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from profiles.errors import Refused, UsageError
from profiles.files import replace

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec

__all__ = ["EXTRA", "CertificateOf", "Role", "context", "make", "the_one"]

Role = Literal["gateway", "client"]
EXTRA = "several computers need the extra 'fleet': pip install 'tworelay[fleet]'"
DAYS = 3650
_CA_DAYS = 7300
_BEFORE = 400  # days that a clock may be behind the one that made a certificate


class CertificateOf(NamedTuple):
    """Files of one certificate; its key can be read by its owner alone."""

    ca: Path
    certificate: Path
    key: Path


def _files(folder: Path, role: Role, name: str) -> CertificateOf:
    stem = f"{role}-{name}"
    return CertificateOf(folder / "ca.crt", folder / f"{stem}.crt", folder / f"{stem}.key")


def the_one(folder: Path, role: Role, name: str | None = None) -> tuple[str, CertificateOf]:
    """The name of a role in a folder, and its files; raises UsageError, Refused."""
    if not folder.is_dir():
        raise UsageError(f"{folder}: there is no such folder; {_how(role)}")
    found = sorted(path.stem.removeprefix(f"{role}-") for path in folder.glob(f"{role}-*.crt"))
    if name is None:
        if len(found) != 1:
            which = ", ".join(found) or "none"
            more = "--name says which" if role == "gateway" else "leave its own alone in the folder"
            raise UsageError(
                f"{folder}: must have one certificate of a {role}, and has: {which}",
                hint=more if found else _how(role),
            )
        name = found[0]
    files = _files(folder, role, name)
    for path in files:
        if not path.is_file():
            there = f"; there are: {', '.join(found)}" if found else ""
            raise UsageError(f"{path}: is not there{there}", hint=_how(role))
    if sys.platform != "win32" and files.key.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise Refused(
            f"{files.key}: others can read it, and who has it can move axes",
            code="refused.key",
            hint=f"chmod 600 {files.key}; if others may have read it, make new keys",
        )
    return name, files


def _how(role: Role) -> str:
    return (
        f"copy ca.crt, {role}-NAME.crt and {role}-NAME.key there, from where 'tworelay fleet keys' "
        "has made them"
    )


def context(files: CertificateOf, role: Role) -> ssl.SSLContext:
    """TLS of one end: both show a certificate, and each checks role and signature of the other's.

    A client checks the name, too. Raises UsageError where a file is none of that kind.
    """
    purpose = ssl.Purpose.CLIENT_AUTH if role == "gateway" else ssl.Purpose.SERVER_AUTH
    try:
        found = ssl.create_default_context(purpose, cafile=str(files.ca))
        found.load_cert_chain(files.certificate, files.key)
    except (ssl.SSLError, OSError) as error:
        raise UsageError(
            f"{files.certificate.parent}: no certificate with its key and its ca.crt ({error})"
        ) from None
    found.minimum_version = ssl.TLSVersion.TLSv1_3
    found.verify_mode = ssl.CERT_REQUIRED
    found.verify_flags |= ssl.VERIFY_X509_STRICT
    found.check_hostname = role == "client"
    return found


# -- the small authority --------------------------------------------------------------------------


def make(
    folder: Path, gateways: tuple[str, ...], clients: tuple[str, ...], days: int = DAYS
) -> Iterator[tuple[Role, str, CertificateOf]]:
    """Make the authority, if there is none yet, and certificates that are not there yet.

    Raises UsageError.
    """
    try:
        from cryptography import x509
    except ImportError:
        raise UsageError(EXTRA) from None
    wanted: list[tuple[Role, str]] = [("gateway", name) for name in gateways]
    wanted += [("client", name) for name in clients]
    for role, name in wanted:
        path = _files(folder, role, name).certificate
        if path.exists():
            raise UsageError(
                f"{path}: is there already, and is not replaced", hint="move it away first"
            )
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        raise UsageError(f"{folder}: is no folder, and cannot be made: {error.strerror}") from None
    ca, ca_key = _authority(folder)
    for role, name in wanted:
        files = _files(folder, role, name)
        key = _new_key()
        use = x509.oid.ExtendedKeyUsageOID
        builder = (
            _begun(name, ca.subject, key, days)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
            .add_extension(
                x509.ExtendedKeyUsage([use.SERVER_AUTH if role == "gateway" else use.CLIENT_AUTH]),
                critical=True,
            )
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(ca_key.public_key()),
                critical=False,
            )
        )
        _keep(files.certificate, files.key, builder, key, ca_key)
        yield role, name, files


def _authority(folder: Path) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """The authority of a folder, made where there is none."""
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    certificate, key = folder / "ca.crt", folder / "ca.key"
    if not certificate.exists() and not key.exists():
        new = _new_key()
        name = "tworelay " + datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
        signs = x509.KeyUsage(
            digital_signature=False, content_commitment=False, key_encipherment=False,
            data_encipherment=False, key_agreement=False, key_cert_sign=True, crl_sign=True,
            encipher_only=False, decipher_only=False,
        )  # fmt: skip
        builder = (
            _begun(name, None, new, _CA_DAYS)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(signs, critical=True)
        )
        _keep(certificate, key, builder, new, new)
    try:
        found = load_pem_private_key(key.read_bytes(), None)
        ca = x509.load_pem_x509_certificate(certificate.read_bytes())
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(
            f"{folder}: has no ca.crt with its ca.key ({error}): certificates are made where the "
            "authority is"
        ) from None
    if not isinstance(found, ec.EllipticCurvePrivateKey):
        raise UsageError(f"{key}: is no key that 'tworelay fleet keys' has made")
    return ca, found


def _new_key() -> ec.EllipticCurvePrivateKey:
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def _begun(
    name: str, issuer: x509.Name | None, key: ec.EllipticCurvePrivateKey, days: int
) -> x509.CertificateBuilder:
    from cryptography import x509

    subject = x509.Name([x509.NameAttribute(x509.oid.NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer or subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=_BEFORE))
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _keep(
    certificate: Path,
    key: Path,
    builder: x509.CertificateBuilder,
    own: ec.EllipticCurvePrivateKey,
    signer: ec.EllipticCurvePrivateKey,
) -> None:
    """Sign and write; the key first, which only its owner can ever read."""
    from cryptography.hazmat.primitives import hashes, serialization

    signed = builder.sign(signer, hashes.SHA256())
    private = own.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )  # fmt: skip
    try:
        key.touch(mode=0o600, exist_ok=False)
        key.write_bytes(private)
        replace(certificate, signed.public_bytes(serialization.Encoding.PEM))
    except OSError as error:
        raise UsageError(f"{key}: cannot be written: {error.strerror or error}") from None
