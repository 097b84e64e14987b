"""The settings of the service, from a file, the environment and flags, each with its origin.

Later wins: default, file (YAML or JSON), ``DEPTHSR_<NAME>`` of the environment, flag. The
variables are DEPTHSR_HOST, DEPTHSR_PORT, DEPTHSR_DATA, DEPTHSR_ROOTS, DEPTHSR_TOKEN_FILE,
DEPTHSR_WORKERS and so on: the name of the field in capitals.
"""

from __future__ import annotations

import dataclasses
import re
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.config import option_name, setting
from pipeline.errors import ConfigurationError
from service.bus.config import (
    DEFAULT_ENDPOINT,
    MODES,
    BusConfig,
    is_loopback,
    is_open_to_others,
)
from service.bus.rules import Rights, parse_rights

MIB = 1 << 20
PREFIX = "DEPTHSR_"
"""Of the variables that are read."""


@dataclass(frozen=True, kw_only=True)
class ServiceConfig:
    """Everything ``depthsr serve`` can be told."""

    host: str = setting("127.0.0.1", "address to listen on")
    port: int = setting(8000, "port to listen on; 0 takes a free one")
    data: Path = setting(Path("depthsr-data"), "folder of the database, uploads and results")
    roots: tuple[Path, ...] = setting(
        (), "folders that scenes may be named in, comma-separated", unit="folders"
    )
    token_file: Path | None = setting(
        None, "file of bearer tokens, a line each: NAME SCOPE,SCOPE TOKEN (default: no tokens)"
    )
    workers: int = setting(1, "jobs computed at the same time", unit="processes")
    worker_threads: int = setting(0, "threads of a worker (0: the job's)", unit="threads")
    worker_memory: int = setting(16384, "address space of a worker (0: no limit)", unit="MiB")
    memory_reserve: int = setting(
        1024, "memory that must be free before one more worker begins beside others", unit="MiB"
    )
    worker_nice: int = setting(5, "how far jobs' workers step back for others", unit="nice")
    cluster: str | None = setting(
        None, "compute jobs on the workers of the Dask scheduler there: tcp://HOST:PORT"
    )
    max_attempts: int = setting(3, "times a job is tried when its worker dies", unit="attempts")
    lease: float = setting(30.0, "silence after which a worker counts as hung", unit="seconds")
    stall: float = setting(900.0, "time without progress after which it does", unit="seconds")
    max_body: int = setting(4096, "largest request body", unit="MiB")
    max_files: int = setting(10_000, "largest number of files of a job", unit="files")
    max_pixels: int = setting(1 << 25, "largest picture of one view", unit="pixels")
    max_frames: int = setting(100_000, "largest number of frames of a job", unit="frames")
    max_queue: int = setting(1000, "unfinished jobs of one client", unit="jobs")
    quota: int = setting(102_400, "largest size of the data folder", unit="MiB")
    client_quota: int = setting(
        0, "largest size of what one client has there (0: no limit of its own)", unit="MiB"
    )
    disk_reserve: int = setting(256, "disk space to leave free", unit="MiB")
    grace: float = setting(5.0, "time for an orderly end", unit="seconds")
    zenoh: str = setting(
        "router",
        "part to play on the bus of streams, or off",
        choices=("router", "peer", "client", "off"),
    )
    zenoh_listen: tuple[str, ...] = setting(
        (DEFAULT_ENDPOINT,), "endpoints to listen on, comma-separated; not as client"
    )
    zenoh_connect: tuple[str, ...] = setting((), "endpoints to connect to, comma-separated")
    zenoh_ca: Path | None = setting(None, "certificate of the authority that others' are signed by")
    zenoh_certificate: Path | None = setting(None, "our certificate (PEM)")
    zenoh_key: Path | None = setting(None, "private key of our certificate (PEM)")
    zenoh_mutual_tls: bool = setting(False, "take only those with a certificate of the authority")
    zenoh_users: Path | None = setting(None, "file of who may connect, a line each: NAME:PASSWORD")
    zenoh_rights: Path | None = setting(
        None, "file of who may publish into and watch which stream (default: everybody all)"
    )
    zenoh_user: str | None = setting(None, "name to give when connecting")
    zenoh_password_file: Path | None = setting(None, "file of the password to give when connecting")
    max_streams: int = setting(2, "streams at the same time", unit="streams")
    max_views: int = setting(16, "views of a stream", unit="views")
    max_payload: int = setting(64, "largest picture that a stream takes", unit="MiB")
    max_rate: float = setting(60.0, "frames a second that a stream takes", unit="frames a second")
    log_level: str = setting(
        "info", "least severe log lines", choices=("debug", "info", "warning", "error")
    )

    def __post_init__(self) -> None:
        limits = {
            "port": (0, 65535), "workers": (0, 256), "worker_threads": (0, 256),
            "worker_memory": (0, 1 << 24), "memory_reserve": (0, 1 << 24), "worker_nice": (0, 19),
            "max_attempts": (1, 100),
            "lease": (1, 3600), "stall": (1, 86400), "max_body": (1, 1 << 24),
            "max_files": (1, 1_000_000), "max_pixels": (1, 1 << 30),
            "max_frames": (1, 10_000_000), "max_queue": (1, 1_000_000),
            "quota": (1, 1 << 30), "client_quota": (0, 1 << 30), "disk_reserve": (0, 1 << 24),
            "grace": (0.1, 600), "max_streams": (0, 256), "max_views": (2, 256),
            "max_payload": (1, 1024), "max_rate": (0.1, 1000),
        }  # fmt: skip
        for name, (least, most) in limits.items():
            if not least <= getattr(self, name) <= most:
                raise ConfigurationError(
                    f"{option_name(name)}: must be {least} to {most}, not {getattr(self, name)}"
                )
        if self.cluster is not None and not re.match(r"(tcp|tls)://.+:\d+$", self.cluster):
            raise ConfigurationError(
                f"--cluster: {self.cluster!r} is no address; write tcp://HOST:PORT"
            )
        if self.log_level not in ("debug", "info", "warning", "error"):
            raise ConfigurationError(f"--log-level: {self.log_level!r} is not a level")
        if self.zenoh not in MODES:
            raise ConfigurationError(f"--zenoh: must be one of {', '.join(MODES)}")
        if self.zenoh != "off":
            self.bus()  # are its settings possible?

    def open_doors(self) -> tuple[str, ...]:
        """Return a sentence for each door that other machines reach and that asks for nothing."""
        said = []
        if self.token_file is None and not is_loopback(self.host):
            said.append(f"--host {self.host}: whoever reaches it may do all; use --token-file")
        if self.zenoh in ("router", "peer") and self.zenoh_users is None:
            said += [
                f"--zenoh-listen {endpoint}: whoever reaches it may publish and watch; "
                "use --zenoh-users, or tls/ with --zenoh-mutual-tls"
                for endpoint in self.zenoh_listen
                if is_open_to_others(endpoint) and not self.zenoh_mutual_tls
            ]
        return tuple(said)

    def missing_roots(self) -> tuple[str, ...]:
        """Return a sentence for each root that is not there (yet)."""
        return tuple(
            f"--roots: {root}: there is no such folder" for root in self.roots if not root.is_dir()
        )

    def bus(self) -> BusConfig:
        """Return how the bus of streams is reached.

        Raises
        ------
        ConfigurationError
            If an endpoint is none, a file is missing, or settings contradict each other.
        """
        password = None
        if self.zenoh_password_file is not None:
            try:
                password = self.zenoh_password_file.read_text(encoding="utf-8").strip()
            except (OSError, ValueError) as error:
                raise ConfigurationError(
                    f"--zenoh-password-file: {self.zenoh_password_file} cannot be read: {error}"
                ) from error
        rights = None if self.zenoh_rights is None else _rights(self.zenoh_rights)
        open_sockets = any(item.startswith("unixsock-stream/") for item in self.zenoh_listen)
        if rights is not None and self.zenoh_users is None and open_sockets:
            raise ConfigurationError(
                "--zenoh-rights: who comes by a socket has no certificate; use --zenoh-users too"
            )
        return BusConfig(
            rights=rights,
            mode=self.zenoh,
            listen=() if self.zenoh == "client" else self.zenoh_listen,
            connect=self.zenoh_connect,
            ca=self.zenoh_ca,
            certificate=self.zenoh_certificate,
            key=self.zenoh_key,
            mutual_tls=self.zenoh_mutual_tls,
            user=self.zenoh_user,
            password=password,
            users_file=self.zenoh_users,
            max_message=(self.max_payload + 1) * MIB,
        )


@dataclass(frozen=True, kw_only=True)
class LoadedConfig:
    """The settings, and where each came from."""

    config: ServiceConfig
    origins: Mapping[str, str]
    """``default``, ``file PATH``, ``environment NAME`` or ``flag --name`` by field."""


def load_config(
    *,
    file: Path | None = None,
    environment: Mapping[str, str] | None = None,
    flags: Mapping[str, Any] | None = None,
) -> LoadedConfig:
    """Return the settings put together from everything that may say something.

    Raises
    ------
    ConfigurationError
        If the file cannot be read, names an unknown setting, or a value is out of range.
    """
    environment = environment or {}
    fields = {item.name for item in dataclasses.fields(ServiceConfig)}
    values: dict[str, Any] = {}
    origins = dict.fromkeys(fields, "default")
    if file is not None:
        for name, value in _read(file).items():
            if name not in fields:
                raise ConfigurationError(f"{file}: there is no setting {name!r}")
            values[name] = _value(name, value, f"{file}: {name}")
            origins[name] = f"file {file}"
    for name in fields:
        variable = PREFIX + name.upper()
        if variable in environment:
            values[name] = _value(name, environment[variable], variable)
            origins[name] = f"environment {variable}"
    for name, value in (flags or {}).items():
        values[name] = _value(name, value, option_name(name))
        origins[name] = f"flag {option_name(name)}"
    return LoadedConfig(config=ServiceConfig(**values), origins=origins)


def format_config(loaded: LoadedConfig) -> str:
    """Return a line for each setting: its name, value and origin."""
    rows = []
    for item in dataclasses.fields(ServiceConfig):
        value = getattr(loaded.config, item.name)
        shown = ",".join(map(str, value if isinstance(value, tuple) else [value]))
        rows.append(
            (item.name, "none" if shown in ("", "None") else shown, loaded.origins[item.name])
        )
    widths = [max(len(row[column]) for row in rows) for column in range(2)]
    return "\n".join(f"{name:<{widths[0]}}  {v:<{widths[1]}}  {o}" for name, v, o in rows)


def _rights(file: Path) -> tuple[Rights, ...]:
    try:
        return parse_rights(_yaml(file))
    except ConfigurationError as error:
        raise ConfigurationError(f"--zenoh-rights: {file}: {error}") from None


def _yaml(file: Path) -> Any:
    import yaml

    try:
        return yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigurationError(f"{file}: cannot be read: {error}") from error


def _read(file: Path) -> dict[str, Any]:
    content = _yaml(file)
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigurationError(f"{file}: must hold settings by name")
    return content


def _value(name: str, value: Any, where: str) -> Any:
    """Return the value in the type of the field."""
    hint = typing.get_type_hints(ServiceConfig)[name]
    if isinstance(hint, types.UnionType):
        if value is None or value == "":
            return None
        hint = next(part for part in typing.get_args(hint) if part is not type(None))
    try:
        if typing.get_origin(hint) is tuple:
            parts = value.split(",") if isinstance(value, str) else value
            kind = typing.get_args(hint)[0]
            return tuple(kind(str(part).strip()) for part in parts if str(part).strip())
        if hint is bool and isinstance(value, str):
            return _TRUTH[value.strip().lower()]
        return hint(value)
    except (TypeError, ValueError, KeyError) as error:
        raise ConfigurationError(f"{where}: {value!r} is not a {hint.__name__}") from error


_TRUTH = {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}
