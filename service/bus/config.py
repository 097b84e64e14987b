"""How a bus is reached: mode, endpoints, certificates, passwords."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pipeline.config import setting
from pipeline.errors import ConfigurationError
from service.bus.rules import Rights

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
MODES = ("router", "peer", "client", "off")


@dataclass(frozen=True, kw_only=True)
class BusConfig:
    """Everything a connection can be told; nothing is looked for by multicast."""

    mode: str = setting("client", "part to play", choices=MODES[:3])
    listen: tuple[str, ...] = setting((), "endpoints to listen on")
    connect: tuple[str, ...] = setting((), "endpoints to connect to")
    ca: Path | None = setting(None, "certificate of the authority that others' are signed by")
    certificate: Path | None = setting(None, "our certificate (PEM)")
    key: Path | None = setting(None, "private key of our certificate (PEM)")
    mutual_tls: bool = setting(False, "take only those who show a certificate of the authority")
    user: str | None = setting(None, "name to give when connecting")
    password: str | None = setting(None, "password to give when connecting")
    users_file: Path | None = setting(None, "who may connect: NAME:PASSWORD a line")
    rights: tuple[Rights, ...] | None = setting(None, "who may do what (None: everybody all)")
    workers_user: str | None = setting(None, "name of our own workers, who may do everything")
    max_message: int = setting(64 << 20, "largest message taken", unit="bytes")

    def __post_init__(self) -> None:
        for name in ("listen", "connect"):
            for endpoint in getattr(self, name):
                check_endpoint(endpoint)
        if (self.certificate is None) != (self.key is None):
            raise ConfigurationError("a certificate and its key: name both, or neither")
        if self.mode == "client" and not self.connect:
            raise ConfigurationError("a zenoh client needs an endpoint to connect to")
        self._check_rights()
        self._check_tls()
        for path in (self.ca, self.certificate, self.key, self.users_file):
            if path is not None and not path.is_file():
                raise ConfigurationError(f"{path}: there is no such file")

    def _check_rights(self) -> None:
        """Refuse rights that could not be held: without names, or where another one decides."""
        if self.rights is None:
            return
        if self.mode == "client":
            raise ConfigurationError(
                "access rules: those of the router hold, for a client has none"
            )
        if self.users_file is None and not self.mutual_tls:
            raise ConfigurationError("access rules need names: passwords, or mutual TLS")

    def _check_tls(self) -> None:
        """Refuse TLS that could not be spoken, and mutual TLS that others could walk around."""
        ours = [endpoint for endpoint in self.listen if speaks_tls(endpoint)]
        if ours and self.certificate is None:
            raise ConfigurationError(f"{ours[0]}: needs a certificate and its key")
        if not self.mutual_tls or self.mode == "client":
            return
        plain = [item for item in self.listen if is_open_to_others(item) and item not in ours]
        if self.ca is None or not ours or plain:
            raise ConfigurationError(
                "mutual TLS needs the certificate of an authority, an endpoint of TLS (tls/ or "
                f"quic/), and no other one that other machines reach{': ' * bool(plain)}"
                f"{', '.join(plain)}"
            )


def check_endpoint(endpoint: str) -> None:
    """Refuse what is no endpoint.

    >>> check_endpoint("tcp/127.0.0.1:7447")
    """
    kind, slash, address = endpoint.partition("/")
    kinds = ("tcp", "tls", "quic", "ws", "unixsock-stream")
    if kind not in kinds or not slash or not address:
        raise ConfigurationError(
            f"{endpoint!r} is no endpoint: write KIND/ADDRESS, such as {DEFAULT_ENDPOINT}; "
            f"kinds are {', '.join(kinds)}"
        )


def is_open_to_others(endpoint: str) -> bool:
    """Tell whether others than this machine reach an endpoint that is listened on.

    >>> is_open_to_others("tcp/127.0.0.1:7447"), is_open_to_others("tcp/0.0.0.0:7447")
    (False, True)
    """
    kind, _, address = endpoint.partition("/")
    return kind != "unixsock-stream" and not is_loopback(address.rpartition(":")[0].strip("[]"))


def is_loopback(host: str) -> bool:
    """Tell whether only this machine reaches what listens there.

    >>> is_loopback("127.0.0.1"), is_loopback("0.0.0.0"), is_loopback("")
    (True, False, False)
    """
    return host in ("localhost", "::1") or host.startswith("127.")


def speaks_tls(endpoint: str) -> bool:
    """Tell whether an endpoint is encrypted.

    >>> speaks_tls("tls/camera.example:7447"), speaks_tls("tcp/127.0.0.1:7447")
    (True, False)
    """
    return endpoint.startswith(("tls/", "quic/"))
