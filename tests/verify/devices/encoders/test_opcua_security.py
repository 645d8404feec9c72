"""OPC UA over an encrypted channel: the driver against a server of asyncua that takes no other."""

import asyncio
import shutil
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.support.devices.bench import gather, kept, same_angles
from tests.support.recorded import refusal
from verify.devices.encoders.opcua import OpcUaEncoders, OpcUaSecurity, OpcUaSettings

pytest.importorskip("asyncua")
from asyncua import Server, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.truststore import TrustStore
from asyncua.crypto.validator import CertificateValidator, CertificateValidatorOptions
from asyncua.server.user_managers import UserManager
from cryptography.x509.oid import ExtendedKeyUsageOID

NODES = ("ns=2;s=Axes",)


def make_certificate(folder: Path, name: str, uri: str) -> None:
    """Make a certificate (DER) and its key (PEM)."""
    certificate, key = folder / f"{name}.der", folder / f"{name}.pem"
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    asyncio.run(setup_self_signed_certificate(key, certificate, uri, "localhost", uses, {}))


class OneUser(UserManager):
    def get_user(
        self, iserver: Any, username: Any = None, password: Any = None, certificate: Any = None
    ) -> User | None:
        del iserver, certificate
        known = (username, password) == ("reader", "secret")
        return User(role=UserRole.User, name="reader") if known else None


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    (folder / "trusted").mkdir()
    make_certificate(folder, "own", "urn:lab:verify")
    shutil.copy(folder / "own.der", folder / "trusted")
    make_certificate(folder, "server", "urn:lab:server")
    return folder


@pytest.fixture(scope="module")
def url(folder: Path) -> Iterator[str]:
    """Where a server listens that wants Basic256Sha256, a certificate that it knows and a user."""
    loop, listening, where = asyncio.new_event_loop(), threading.Event(), []

    async def start() -> Server:
        server = Server(user_manager=OneUser())
        await server.init()
        server.set_endpoint("opc.tcp://127.0.0.1:0")
        await server.set_application_uri("urn:lab:server")
        server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        server.set_identity_tokens([ua.UserNameIdentityToken])
        await server.load_certificate(str(folder / "server.der"))
        await server.load_private_key(str(folder / "server.pem"))
        store = TrustStore([folder / "trusted"], [])
        await store.load()
        options = CertificateValidatorOptions.TRUSTED_VALIDATION
        options |= CertificateValidatorOptions.PEER_CLIENT
        server.set_certificate_validator(CertificateValidator(options, store))
        await server.register_namespace("urn:lab")
        node = ua.NodeId.from_string(NODES[0])
        data = ua.DataValue(
            ua.Variant([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], ua.VariantType.Double),
            SourceTimestamp=ua.datetime.now(),
        )
        axes = await server.nodes.objects.add_variable(node, "Axes", data.Value.Value)
        await server.start()
        await axes.write_value(data)
        where.append(f"opc.tcp://127.0.0.1:{server.bserver.port}")
        return server

    def serve() -> None:
        server = loop.run_until_complete(start())
        listening.set()
        loop.run_forever()
        loop.run_until_complete(server.stop())
        loop.close()

    thread = threading.Thread(target=serve)
    thread.start()
    assert listening.wait(20.0)
    yield where[0]
    loop.call_soon_threadsafe(loop.stop)
    thread.join()


def own(folder: Path, **changes: Any) -> OpcUaSecurity:
    security = OpcUaSecurity(folder / "own.der", folder / "own.pem")
    return replace(security, **changes)


@pytest.mark.realtime
@pytest.mark.parametrize("known", [False, True])
def test_an_encrypted_server_is_read_by_its_certificate_and_user(
    folder: Path, url: str, known: bool
) -> None:
    security = own(folder, server_certificate=folder / "server.der" if known else None)
    settings = OpcUaSettings(url, NODES, security=security, user="reader", password="secret")
    encoders = kept(OpcUaEncoders(settings, same_angles(6)))
    readings = gather(encoders, lambda found: len(found) >= 5)
    assert readings[-1].q == pytest.approx([0.01745329 * j for j in range(1, 7)], abs=1e-7)
    assert "secret" not in repr(settings)


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("who", "words"),
    [
        ("nobody", "BadIdentityTokenRejected"),
        ("wrong password", "BadUserAccessDenied"),
        ("stranger", "BadCertificateUntrusted"),
        ("other server", "another certificate than server_certificate"),
        ("plain", "no channel of this security"),
    ],
)
def test_who_may_not_read_is_told_so(folder: Path, url: str, who: str, words: str) -> None:
    security: OpcUaSecurity | None = own(folder)
    if who == "stranger":
        security = OpcUaSecurity(folder / "server.der", folder / "server.pem")
    elif who == "other server":
        security = own(folder, server_certificate=folder / "own.der")
    elif who == "plain":
        security = None
    password = "guess" if who == "wrong password" else "secret"
    user = "" if who == "nobody" else "reader"
    settings = OpcUaSettings(url, NODES, security=security, user=user, password=password)
    encoders = kept(OpcUaEncoders(settings, same_angles(6)))
    assert encoders.read() == []  # it connects, and waits for the server meanwhile
    state = encoders.state()
    assert not state.connected
    assert words.lower() in state.sentence
    assert "\n" not in state.sentence
    assert "secret" not in state.sentence


def test_files_that_are_no_certificate_or_key_are_refused(folder: Path, tmp_path: Path) -> None:
    certificate, key = folder / "own.der", folder / "own.pem"
    other, noise = folder / "server.pem", tmp_path / "noise.pem"
    noise.write_bytes(b"-----BEGIN CERTIFICATE-----\nnone\n-----END CERTIFICATE-----\n")
    for files, words in (
        ((noise, key), "noise.pem: is no X.509 certificate; PEM or DER is expected"),
        ((certificate, noise), "noise.pem: is no private key without a password"),
        ((certificate, other), "server.pem: is not the key of own.der"),
        ((tmp_path / "none.der", key), "none.der: no such file"),
        ((certificate, key, noise), "noise.pem: is no X.509 certificate"),
    ):
        assert words in str(refusal(OpcUaSecurity, *files))
