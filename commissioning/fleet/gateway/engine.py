"""The door to `distributed`: its scheduler, one worker and one actor are transport, no more.

It is never asked to run what moves an axis: an error of it says nothing about whether an axis has
moved, only the ledger of the gateway does.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import ssl
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import dask
from tornado.httpserver import HTTPServer

from commissioning.fleet.gateway.addresses import host_and_port
from commissioning.fleet.gateway.messages import News
from commissioning.fleet.gateway.station import Station
from commissioning.result.fleet_codec import of_json
from drivers.errors import LinkError, LinkLost
from profiles.errors import TwoRelayError

dask.config.refresh(paths=[], env={})  # not what this computer has set for other work
SETTINGS = {
    "distributed.scheduler.allowed-failures": 0,  # nothing is done again
    "distributed.scheduler.work-stealing": False,
    "distributed.scheduler.no-workers-timeout": "30s",
    "distributed.scheduler.worker-ttl": "365d",  # a loop that is starved is not a dead one
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.scheduler.preload": [],
    "distributed.worker.preload": [],
    "distributed.comm.require-encryption": True,
    "distributed.comm.retry.count": 0,
    "distributed.comm.timeouts.connect": "5s",
    "distributed.comm.timeouts.tcp": "20s",
    "distributed.admin.system-monitor.interval": "1h",
    "distributed.worker.profile.enabled": False,
    "distributed.logging": dict.fromkeys(
        ("distributed", "distributed.client", "tornado", "tornado.application"),
        "debug" if os.environ.get("TWORELAY_ENGINE_LOG") else "critical",
    ),
}
BLOCKED = [  # what a client has no need of
    "adaptive_target", "add_keys", "benchmark_hardware", "broadcast", "call_stack",
    "dump_cluster_state_to_url", "feed", "get_cluster_state", "get_logs", "get_metadata",
    "get_profile", "get_story", "get_task_stream", "logs", "performance_report",
    "profile", "rebalance", "register_nanny", "register_nanny_plugin",
    "register_scheduler_plugin", "register_worker_plugin", "replicate", "restart",
    "restart_workers", "retire_workers", "retry", "run_function", "scatter", "set_metadata",
    "set_resources", "set_restrictions", "start_task_metadata", "stop_task_metadata", "terminate",
    "unregister_nanny_plugin", "unregister_scheduler_plugin",
    "unregister_worker_plugin", "update_data", "worker_logs", "workers_to_close",
]  # fmt: skip
dask.config.set({**SETTINGS})

from distributed import Client, Scheduler, Security, Worker  # noqa: E402  it reads its settings
from distributed.http.routing import RoutingApplication  # noqa: E402
from distributed.protocol.serialize import Serialized, deserialize  # noqa: E402

__all__ = ["BLOCKED", "SETTINGS", "Office", "open_line", "serve"]

_NEWS = 1.0  # s that a client is kept waiting for news
_TOGETHER = 0.03  # s in which what comes is told at once
_TO_CLOSE = 2.0  # s


class _Tls(Security):
    """Our own TLS: both ends show a certificate, and the client knows by which name."""

    __slots__ = ("_context", "_name")

    def __init__(self, context: ssl.SSLContext, name: str | None = None) -> None:
        super().__init__(require_encryption=True)
        self._context, self._name = context, name

    def get_connection_args(self, role: str) -> Mapping[str, object]:
        return {
            "ssl_context": self._context, "require_encryption": True,
            "server_hostname": self._name, "extra_conn_args": {},
        }  # fmt: skip

    def get_listen_args(self, role: str) -> Mapping[str, object]:
        return {"ssl_context": self._context, "require_encryption": True}


class _NoPages:
    """Listens on no port for pages about itself."""

    def start_http_server(self, routes: Any, *_: Any, **__: Any) -> None:
        self.http_application = RoutingApplication([])
        self.http_server = HTTPServer(self.http_application)
        self.http_server.port = 0  # type: ignore[attr-defined]


class _Scheduler(_NoPages, Scheduler):
    def __init__(self, host: str, port: int, tls: _Tls) -> None:
        super().__init__(
            host=host, port=port, protocol="tls", security=tls, dashboard=False,
            blocked_handlers=BLOCKED,
        )  # fmt: skip
        # its worker is in this process: no socket leads to it, and no certificate is needed
        self._start_address = [*self._start_address, "inproc://"]


class _Worker(_NoPages, Worker):
    pass


class _Desk:
    """What the actors of all clients share: the station, and who waits for news."""

    def __init__(self, station: Station, loop: asyncio.AbstractEventLoop) -> None:
        self.station = station
        self.loop = loop
        self.clerk = ThreadPoolExecutor(1, "clerk")  # one after the other
        self.alarm = ThreadPoolExecutor(1, "alarm")  # a stop waits for nobody
        self.porter = ThreadPoolExecutor(2, "porter")  # what takes long
        self.new = asyncio.Event()

    def on_news(self) -> None:
        """There is some; called by any thread."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self.loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self.new.set()
        self.new = asyncio.Event()

    def executor(self, verb: str) -> ThreadPoolExecutor:
        """Who does it."""
        if verb == "stop":
            return self.alarm
        return self.porter if verb in ("fetch", "restore", "hello") else self.clerk


_desk: _Desk | None = None


class Office:
    """The actor: one a client. It blocks nothing, so that a stop is heard at once."""

    async def call(self, verb: Any, text: Any) -> str:
        """A request as the station takes it, and its answer."""
        desk = _desk
        assert desk is not None, "an actor outside of a gateway"
        verb, text = _plain(verb), _plain(text)
        until = desk.loop.time() + _NEWS
        while True:
            new = desk.new
            answer = await desk.loop.run_in_executor(
                desk.executor(verb), desk.station.handle, verb, text
            )
            left = until - desk.loop.time()
            if verb != "news" or left <= 0 or not _is_empty(answer):
                return answer
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(new.wait(), left)
                await asyncio.sleep(_TOGETHER)


def _plain(value: Any) -> str:
    """A word of a client, which comes as it was packed: scheduler and worker are one process."""
    found = deserialize(value.header, value.frames) if isinstance(value, Serialized) else value
    return str(found)


def _is_empty(answer: str) -> bool:
    if not answer.startswith("+"):
        return False
    return not of_json(answer[1:], News).pieces


async def serve(
    station: Callable[[Callable[[], None]], Station], address: tuple[str, int],
    context: ssl.SSLContext, ready: Callable[[Station, int], None], ended: asyncio.Event,
) -> None:  # fmt: skip
    """A gateway until `ended`; `station` is made with what wakes who waits for news.

    Raises LinkError where the port cannot be had.
    """
    global _desk  # noqa: PLW0603  actors are made by the engine, with nothing in their hands
    loop = asyncio.get_running_loop()
    holder: list[_Desk] = []
    made = station(lambda: holder[0].on_news() if holder else None)
    holder.append(_Desk(made, loop))
    _desk = holder[0]
    tls = _Tls(context)
    over = threading.Event()
    ear = threading.Thread(target=_hear, args=(made, over), daemon=True)
    with tempfile.TemporaryDirectory(prefix="tworelay-") as scratch:
        try:
            host, port = address
            scheduler = await _Scheduler(f"[{host}]" if ":" in host else host, port, tls)
        except (OSError, RuntimeError, ValueError) as error:
            cause: BaseException = error
            while cause.__cause__ is not None:
                cause = cause.__cause__
            why = getattr(cause, "strerror", None) or cause
            raise LinkError(
                f"{address[0]}:{address[1]}: cannot be listened on ({why})", code="gateway.port"
            ) from None
        inside = next(
            one.contact_address
            for one in scheduler.listeners
            if one.contact_address.startswith("inproc://")
        )
        worker = await _Worker(
            inside, protocol="inproc", nthreads=1, name=made.name, security=tls, dashboard=False,
            memory_limit=0, local_directory=scratch,
        )  # fmt: skip
        ear.start()
        try:
            ready(made, scheduler.port)
            await ended.wait()
        finally:
            over.set()
            for one in (worker, scheduler):
                with contextlib.suppress(Exception):
                    await asyncio.wait_for(one.close(), _TO_CLOSE)
            ear.join(_TO_CLOSE)


def _hear(station: Station, over: threading.Event) -> None:
    while not over.is_set():
        try:
            station.hear(0.2)
        except TwoRelayError as error:
            print(f"tworelay: {error}", file=sys.stderr, flush=True)  # noqa: T201


# -- the client's end -----------------------------------------------------------------------------


class _DaskLine:
    """A line to the actor of a gateway."""

    def __init__(self, name: str, client: Any, actor: Any) -> None:
        self._name, self._client, self._actor = name, client, actor

    async def call(self, verb: str, text: str, seconds: float) -> str:
        try:
            answer = await asyncio.wait_for(self._asked(verb, text), seconds)
        except TimeoutError:
            raise self._lost(f"no answer in {seconds:.0f} s") from None
        except Exception as error:  # whatever the engine raises: nobody knows whether it was heard
            raise self._lost(str(error) or type(error).__name__) from None
        return _plain(answer)

    async def _asked(self, verb: str, text: str) -> Any:
        with self._client.as_current():
            return await self._actor.call(verb, text)

    def _lost(self, why: str) -> LinkLost:
        return LinkLost(f"gateway '{self._name}' does not answer ({why})", code="gateway.lost")

    async def close(self) -> None:
        await _closed(self._client)


async def _closed(client: Any) -> None:
    with contextlib.suppress(Exception):  # a line that is broken does not close in order
        await asyncio.wait_for(client.close(), _TO_CLOSE)


async def open_line(name: str, address: str, context: ssl.SSLContext) -> _DaskLine:
    """A line to a gateway; raises LinkError."""
    host, port = host_and_port(address)
    place = f"tls://[{host}]:{port}" if ":" in host else f"tls://{host}:{port}"
    client = Client(
        place, security=_Tls(context, name), asynchronous=True, direct_to_workers=False,
        set_as_default=False, timeout=5, name="tworelay", heartbeat_interval="5s",
    )  # fmt: skip
    try:
        async with asyncio.timeout(10):
            await client
            with client.as_current():
                actor = await client.submit(
                    Office, actor=True, workers=[name], allow_other_workers=False, pure=False,
                    retries=0,
                )  # fmt: skip
        return _DaskLine(name, client, actor)
    except Exception as error:
        await _closed(client)
        raise LinkError(
            f"gateway '{name}' at {host}:{port}: no line ({error or type(error).__name__})",
            code="gateway.lost",
        ) from None
