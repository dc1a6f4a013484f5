"""The web server under the page: where it listens, and whom it answers."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from mdcs_pipeline.errors import InputError, MissingExtraError

LOCAL_HOST = "127.0.0.1"
DEFAULT_PORT = 8080
# Tried in turn where the caller asked for no port in particular.
_TRIES = 20


def import_viser() -> Any:
    """Return the module viser.

    Raises
    ------
    MissingExtraError
        If it cannot be imported.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingExtraError(
            "the live page needs viser",
            received=str(error),
            remedy="pip install 'mdcs-pipeline[viewer]'",
        ) from error
    return viser


def free_port(host: str, port: int | None) -> int:
    """Return a port of `host` on which nobody listens.

    Parameters
    ----------
    host : str
        Address or name of this machine.
    port : int, optional
        The only one to try; 0 lets the system choose. When absent, 8080 and those after it.

    Raises
    ------
    InputError
        If the address is none of this machine's, or the port is taken.
    """
    # Asked beforehand: viser itself would go on to the next port, or wait for ever.
    asked = range(DEFAULT_PORT, DEFAULT_PORT + _TRIES) if port is None else (port,)
    fault: OSError | None = None
    for number in asked:
        try:
            return _bound(host, number)
        except OSError as error:
            fault = error
    if isinstance(fault, socket.gaierror) or (fault and fault.errno in _FOREIGN):
        raise InputError(
            "the page cannot listen there: no such address on this machine",
            received=host,
            remedy=f"{LOCAL_HOST} for this machine alone, 0.0.0.0 for all of its networks",
        )
    raise InputError(
        f"the page cannot listen on port {asked[0]}" + (" or after it" if port is None else ""),
        where=host,
        received=fault.strerror if fault else None,
        remedy="choose another port; 0 takes any that is free",
    )


def _foreign() -> tuple[int, ...]:
    import errno

    return errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT


_FOREIGN = _foreign()


def _bound(host: str, port: int) -> int:
    family, kind, protocol, _, address = socket.getaddrinfo(
        host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )[0]
    with socket.socket(family, kind, protocol) as probe:
        # As asyncio sets it: a port that was closed a moment ago is free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(address)
        return int(probe.getsockname()[1])


def open_server(host: str, port: int | None, title: str) -> Any:
    """Return a running viser server that answers its own pages only.

    Raises
    ------
    MissingExtraError
        If viser is not installed.
    InputError
        If it cannot listen there.
    """
    viser = import_viser()
    chosen = free_port(host, port)
    with silent_rich():
        server = viser.ViserServer(host=host, port=chosen, label=title, verbose=False)
    # What this page shows is not for the internet; viser would lead a tunnel there for
    # whoever asks over the socket.
    server.request_share_url = lambda *_, **__: None
    _refuse_strangers(server, is_local(host))
    return server


def close_server(server: Any) -> None:
    """Stop a server; a second call does nothing."""
    with silent_rich():
        server.stop()


@contextmanager
def silent_rich() -> Iterator[None]:
    """Keep viser's own banners off standard output, where results may go."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def page_url(host: str, port: int) -> str:
    """Return what to type into a browser on this machine."""
    name = LOCAL_HOST if host in ("0.0.0.0", "", "::") else host
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"


def is_local(host: str) -> bool:
    """Return whether a host name or address means this machine's loopback."""
    name = host.strip("[]").lower()
    if name == "localhost" or name.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def is_own_page(host: str | None, origin: str | None, local: bool) -> bool:
    """Return whether a connection comes from the page itself, or from no browser at all.

    Browsers let any web page open a socket to 127.0.0.1; without this check a page from
    elsewhere could read the cloud and run the pipeline.

    Parameters
    ----------
    host, origin : str, optional
        Headers of the request: whom it asked for, and which page asks.
    local : bool
        The server listens on the loopback alone; then no other name may lead to it, as one
        does that a stranger's name server points here.
    """
    if local and not is_local(urlsplit(f"//{host or ''}").hostname or ""):
        return False
    return origin is None or urlsplit(origin).netloc.lower() == (host or "").lower()


def _refuse_strangers(server: Any, local: bool) -> None:
    # viser 1.1 has no setting for this: hence its private names, and the pin in pyproject.
    sockets = server._websock_server

    async def check(client: Any) -> None:
        connection = sockets._live_connections[client.client_id]
        headers = connection.request.headers
        if not is_own_page(headers.get("Host"), headers.get("Origin"), local):
            await connection.close(1008, "this page belongs to another site")

    # First, before viser's own callbacks let the client see or do anything.
    sockets._client_connect_cb.insert(0, check)
