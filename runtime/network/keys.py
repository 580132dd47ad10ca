"""The keys of a cell: a certificate authority of its own, and a certificate with a private key for each role.

DIR/ca.pem      whom the cell trusts; every machine of the cell needs it
DIR/ca.key      makes more certificates; belongs where `palpate keys` was run, and nowhere else
DIR/ROLE.pem    a role's certificate: its name is the role's
DIR/ROLE.key    its private key, without a password: a cell starts without a person
"""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from runtime.clock import wall_nanoseconds
from runtime.errors import InputError, alternatives
from runtime.network.access import ROLES, ROUTER
from runtime.network.meeting_point import EVERYWHERE

CA = "ca"
DAYS = 730  # that certificates are valid
_CA_DAYS = 7300  # that the authority is, which signs those that follow
_SKEW = timedelta(hours=1)  # that another machine's clock may be behind
_ALWAYS = ("localhost", "127.0.0.1", "::1")  # names that the router has on its own machine


@dataclass(frozen=True)
class Credentials:
    """Where one role's certificate, its private key and the cell's authority are."""

    authority: Path
    certificate: Path
    key: Path


def credentials(folder: Path, role: str, hosts: Sequence[str] = ()) -> Credentials:
    """What a role shows to the cell, where its clients know it by one of `hosts`.

    Raises InputError if it is not there, cannot be read, is out of date or names other hosts.
    """
    found = Credentials(folder / f"{CA}.pem", folder / f"{role}.pem", folder / f"{role}.key")
    for path in (found.authority, found.certificate, found.key):
        if not os.access(path, os.R_OK):
            why = "cannot be read" if path.exists() else "is missing"
            raise InputError(f"{path} {why}; 'palpate keys {folder}' makes the keys of a cell, once and on one machine")
    for path in (found.authority, found.certificate):
        until = _certificate(path).not_valid_after_utc
        if until < _now():
            raise InputError(
                f"{path} was valid until {until:%Y-%m-%d}; 'palpate keys {folder} --renew' makes a new one"
            )
    named = [*_names(found.certificate), *EVERYWHERE]
    if (unnamed := next((host for host in hosts if host not in named), None)) is not None:
        raise InputError(
            f"{found.certificate} does not name {unnamed}; 'palpate keys {folder} --renew --role {role} "
            f"--host {unnamed}' adds it"
        )
    if found.key.stat().st_mode & 0o077:
        raise InputError(f"{found.key} can be read by others than its owner; 'chmod 600 {found.key}' mends it")
    return found


def make_keys(
    folder: Path, roles: Sequence[str] = ROLES, hosts: Sequence[str] = (), days: int = DAYS, *, renew: bool = False
) -> list[Path]:
    """Make certificates for roles, and the authority if there is none yet; returns the certificates' files.

    `hosts` are names and addresses by which clients on other machines reach the router. `renew` replaces what is there,
    and keeps the names of the router's old certificate. Raises InputError rather than overwrite anything unasked.
    """
    for role in roles:
        if role not in ROLES:
            raise InputError(f"no plugin has the role {role!r}; {alternatives(role, ROLES)}")
    present = [path for role in roles for path in _files(folder, role) if path.exists()]
    if present and not renew:
        raise InputError(f"{present[0]} is there already; --renew replaces it, and --role ROLE makes others")
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        authority, signer = _authority(folder)
        names = [*_ALWAYS, *hosts, *(_names(folder / f"{ROUTER}.pem") if renew else ())]
        for role in roles:
            _make(folder, role, authority, signer, names, timedelta(days=days))
    except OSError as error:
        raise InputError(f"keys cannot be written to {folder}: {error.strerror or error}") from None
    return [folder / f"{role}.pem" for role in roles]


def _files(folder: Path, name: str) -> tuple[Path, Path]:
    return folder / f"{name}.pem", folder / f"{name}.key"


def _authority(folder: Path) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """The cell's authority, made if there is none."""
    certificate, key = _files(folder, CA)
    if not certificate.exists() and not key.exists():
        signer = ec.generate_private_key(ec.SECP256R1())
        name = _name(f"palpate cell {x509.random_serial_number():x}"[:30])
        builder = (
            _builder(name, name, signer.public_key(), timedelta(days=_CA_DAYS))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs=True), critical=True)
        )
        _write(folder, CA, builder.sign(signer, hashes.SHA256()), signer)
    if not key.exists():
        raise InputError(f"{key} is missing: certificates are made where the cell's first ones were")
    try:
        made = serialization.load_pem_private_key(key.read_bytes(), password=None)
    except (ValueError, TypeError):
        raise InputError(f"{key} is no private key without a password") from None
    if not isinstance(made, ec.EllipticCurvePrivateKey):
        raise InputError(f"{key} is no key on an elliptic curve, as 'palpate keys' makes them")
    return _certificate(certificate), made


def _make(
    folder: Path,
    role: str,
    authority: x509.Certificate,
    signer: ec.EllipticCurvePrivateKey,
    hosts: Iterable[str],
    valid: timedelta,
) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    router = role == ROUTER
    # Only the router's certificate may serve: whoever has another one cannot pass for the cell.
    use = ExtendedKeyUsageOID.SERVER_AUTH if router else ExtendedKeyUsageOID.CLIENT_AUTH
    names = [_general(host) for host in dict.fromkeys(hosts)] if router else [x509.DNSName(role.replace("_", "-"))]
    builder = (
        _builder(_name(role), authority.subject, key.public_key(), valid)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage([use]), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
    )
    _write(folder, role, builder.sign(signer, hashes.SHA256()), key)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, valid: timedelta
) -> x509.CertificateBuilder:
    now = _now()
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _SKEW)
        .not_valid_after(now + valid)
    )


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs,
        crl_sign=signs,
        encipher_only=False,
        decipher_only=False,
    )


def _write(folder: Path, name: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
    """Write both files so that at every moment each is the old one or the new one, readable by its owner alone."""
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    certificate_path, key_path = _files(folder, name)
    for path, data in ((key_path, private), (certificate_path, certificate.public_bytes(serialization.Encoding.PEM))):
        fresh = path.with_name(f"{path.name}.new")
        fresh.unlink(missing_ok=True)
        with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(data)
        fresh.replace(path)


def _certificate(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except (OSError, ValueError):
        raise InputError(f"{path} is no certificate") from None


def _names(path: Path) -> list[str]:
    """Names and addresses in a certificate, if there is one."""
    if not path.exists():
        return []
    extension = _certificate(path).extensions.get_extension_for_class(x509.SubjectAlternativeName)
    return [str(name.value) for name in extension.value]


def _general(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        return x509.DNSName(host)
    except ValueError:
        raise InputError(f"{host!r} is neither an IP address nor a host's name") from None


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _now() -> datetime:
    return datetime.fromtimestamp(wall_nanoseconds() / 1e9, UTC)
