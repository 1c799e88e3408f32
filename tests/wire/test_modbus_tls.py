"""Modbus/TCP Security: the ordinary frame inside TLS, with certificates both ways."""

from __future__ import annotations

import re
import shutil
import socket
import ssl
import subprocess
import threading
from pathlib import Path

import pytest

from drivers.errors import LinkError
from drivers.link import axis_of, open_drive
from drivers.modbus.client import Client
from drivers.modbus.wires import TcpWire, Tls
from profiles.errors import UsageError
from tests.raising import raises

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl to make keys")


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Self-signed certificates of a drive and of a client, and the keys."""
    folder = tmp_path_factory.mktemp("keys")
    for name in ("drive", "client", "other"):
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2",
             "-keyout", str(folder / f"{name}.key"), "-out", str(folder / f"{name}.pem"),
             "-subj", f"/CN={name}", "-addext", "subjectAltName=IP:127.0.0.1"],
            check=True, capture_output=True,
        )  # fmt: skip
    return folder


def serve(keys: Path, heard: list[bytes]) -> tuple[int, threading.Thread]:
    """A drive that asks for the client's certificate and answers one read."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(keys / "drive.pem", keys / "drive.key")
    context.load_verify_locations(keys / "client.pem")
    context.verify_mode = ssl.CERT_REQUIRED
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(10)

    def run() -> None:
        plain, _ = listener.accept()
        try:
            with context.wrap_socket(plain, server_side=True) as secure:
                heard.append(secure.recv(100))
                secure.sendall(bytes.fromhex("00 01 00 00 00 05 01 03 02 12 34"))
                secure.recv(100)
        except OSError:
            plain.close()
        listener.close()

    thread = threading.Thread(target=run)
    thread.start()
    return listener.getsockname()[1], thread


def test_the_frame_is_the_ordinary_one_inside_tls(keys: Path) -> None:
    heard: list[bytes] = []
    port, thread = serve(keys, heard)
    tls = Tls(keys / "drive.pem", keys / "client.pem", keys / "client.key")
    client = Client(TcpWire("127.0.0.1", port, tls=tls), 1, 2.0)
    assert client.read(3, 0, 1) == [0x1234]
    client.close()
    thread.join()
    assert heard == [bytes.fromhex("00 01 00 00 00 06 01 03 00 00 00 01")]


def test_a_drive_with_another_authority_is_not_talked_to(keys: Path) -> None:
    heard: list[bytes] = []
    port, thread = serve(keys, heard)
    with pytest.raises(LinkError, match=r"no TLS with 127.0.0.1: .*self.signed certificate"):
        Client(TcpWire("127.0.0.1", port, tls=Tls(keys / "other.pem")), 1, 2.0)
    thread.join()
    assert heard == []


def _openssl(*arguments: str) -> None:
    subprocess.run(["openssl", *arguments], check=True, capture_output=True)


# extensions of the drive's certificate and of its authority's: what strict verification says
OF_OLD = {
    "no key identifier": ("", "Missing Authority Key Identifier"),
    "basic constraints that are not critical": (
        "basicConstraints=CA:TRUE\nkeyUsage=keyCertSign\nsubjectKeyIdentifier=hash\n",
        "Basic Constraints of CA cert not marked critical",
    ),
}


@pytest.mark.parametrize("case", OF_OLD)
def test_a_certificate_of_an_old_kind_is_refused_on_every_python_with_the_remedy(
    tmp_path: Path, case: str
) -> None:
    extensions, words = OF_OLD[case]
    good = "basicConstraints=critical,CA:TRUE\nkeyUsage=critical,keyCertSign\n"
    good += "subjectKeyIdentifier=hash\n"
    (tmp_path / "ca.cnf").write_text(
        f"[req]\ndistinguished_name=n\nprompt=no\nx509_extensions=e\n[n]\nCN=old\n[e]\n"
        f"{extensions or good}"
    )
    leaf = "subjectAltName=IP:127.0.0.1\nsubjectKeyIdentifier=none\n" + (
        "authorityKeyIdentifier=keyid\n" if extensions else "authorityKeyIdentifier=none\n"
    )
    (tmp_path / "leaf.cnf").write_text(leaf)
    at = str(tmp_path)
    _openssl("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-config",
    f"{at}/ca.cnf",
             "-keyout", f"{at}/ca.key", "-out", f"{at}/ca.pem")  # fmt: skip
    _openssl("req", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=drive", "-keyout",
    f"{at}/drive.key",
             "-out", f"{at}/drive.csr")  # fmt: skip
    _openssl("x509", "-req", "-in", f"{at}/drive.csr", "-CA", f"{at}/ca.pem", "-CAkey",
    f"{at}/ca.key",
             "-set_serial", "7", "-days", "2", "-extfile", f"{at}/leaf.cnf",
             "-out", f"{at}/drive.pem")  # fmt: skip
    shutil.copy(tmp_path / "drive.pem", tmp_path / "client.pem")
    port, thread = serve(tmp_path, [])
    with pytest.raises(LinkError) as caught:
        Client(TcpWire("127.0.0.1", port, tls=Tls(tmp_path / "ca.pem")), 1, 2.0)
    thread.join()
    assert words in str(caught.value)
    assert "have both issued anew" in str(caught.value)
    assert str(tmp_path / "ca.pem") in str(caught.value)


def test_a_file_that_is_no_certificate_is_named(keys: Path, tmp_path: Path) -> None:
    nothing = tmp_path / "nothing.pem"
    nothing.write_text("nothing")
    for tls, words in (
        (Tls(tmp_path / "nosuch"), f"ca {tmp_path}/nosuch: cannot be read"), (Tls(nothing),
        f"ca {nothing}"),
        (Tls(keys / "drive.pem", nothing), f"cert {nothing}"), (Tls(tmp_path),
        f"ca {tmp_path}: cannot be"),
        (Tls(keys / "drive.pem", keys / "client.pem", keys / "drive.key"), "KEY_VALUES_MISMATCH"),
        (Tls(keys / "drive.pem", keys / "client.pem", tmp_path / "k"),
        f"key {tmp_path}/k: cannot be read"),
    ):  # fmt: skip
        ours, theirs = socket.socketpair()
        with theirs, pytest.raises(UsageError, match=re.escape(words)):
            tls.wrap(ours, "127.0.0.1")


def test_links_say_what_they_lack(keys: Path) -> None:
    with pytest.raises(UsageError, match="TLS needs ca=FILE"):
        open_drive(axis_of("modbus-tls://127.0.0.1:802?unit=1"))
    missing = axis_of(f"modbus-tls://127.0.0.1:1?unit=1&ca={keys}/nosuch.pem")
    with raises(LinkError, "link.connect"):
        open_drive(missing)
