"""Gives a stream of bytes to everybody who connects, as receivers and casters do."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from deepseis_bringup.listening import listening

BEHIND_BYTES: Final = 1 << 20
"""A client with more than this unread is let go."""
MOST_CLIENTS: Final = 32


class TcpOut:
    """A TCP server in a thread; what clients say is read and left aside.

    Parameters
    ----------
    address : tuple of str and int
        Where it listens; port 0: any that is free; which, says ``port`` afterwards.
    what : str
        Of the stream, for errors.
    greeting : callable, optional
        Gives what a new client gets first.

    Attributes
    ----------
    clients, dropped : int
        That are connected; that were let go because they did not read, or were too many.

    Raises
    ------
    InputError
        The port is taken.
    """

    def __init__(
        self, address: tuple[str, int], what: str, greeting: Callable[[], bytes] = bytes
    ) -> None:
        self.greeting, self.dropped = greeting, 0
        self._socket = listening(*address, what)
        self.port: int = self._socket.getsockname()[1]
        self._writers: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name=f"{what} out", daemon=True)
        self._thread.start()

    @property
    def clients(self) -> int:
        """Clients that are connected."""
        return len(self._writers)

    def put(self, data: bytes) -> None:
        """Send bytes to all clients."""
        if data:
            self._loop.call_soon_threadsafe(self._send, data)

    def close(self) -> None:
        """End, after what was put has left for those who read."""
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(5.0)

    def _run(self) -> None:
        with self._socket:
            self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._client, sock=self._socket)
        await self._stop.wait()
        server.close()
        for writer in list(self._writers):
            writer.close()
            with suppress(OSError, TimeoutError):
                await asyncio.wait_for(writer.wait_closed(), 1.0)

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._writers) >= MOST_CLIENTS:
            self.dropped += 1
            writer.close()
            return
        writer.write(self.greeting())
        self._writers.add(writer)
        with suppress(OSError):
            while await reader.read(4096):
                pass
        self._writers.discard(writer)
        writer.close()

    def _send(self, data: bytes) -> None:
        for writer in list(self._writers):
            writer.write(data)
            if writer.transport.get_write_buffer_size() > BEHIND_BYTES:
                self._writers.discard(writer)
                writer.transport.abort()
                self.dropped += 1
