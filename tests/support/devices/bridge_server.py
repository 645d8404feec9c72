"""A websocket server of aiohttp that says what it is told to, once a client has subscribed."""

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from aiohttp import WSMsgType, web

Say = Callable[[int], str | bytes]  # the number of a message to the message
PERIOD = 0.005  # s from one message to the next


class BridgeServer:
    """What a test sees of it."""

    def __init__(self) -> None:
        self.port = 0
        self.heard: list[str] = []
        self.start = 0.0  # s, monotonic: of the last connection

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.port}"


@contextmanager
def bridge(say: Say) -> Iterator[BridgeServer]:
    server, loop = BridgeServer(), asyncio.new_event_loop()

    async def talk(request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        first = await socket.receive()
        server.heard.append(first.data)
        server.start, number = time.monotonic(), 0
        hearing = asyncio.ensure_future(socket.receive())
        while True:
            if hearing.done():
                if hearing.result().type is not WSMsgType.TEXT:
                    return socket
                server.heard.append(hearing.result().data)
                hearing = asyncio.ensure_future(socket.receive())
            message = say(number)
            if isinstance(message, bytes):
                await socket.send_bytes(message)
            else:
                await socket.send_str(message)
            number += 1
            await asyncio.sleep(PERIOD)

    async def begin() -> web.AppRunner:
        application = web.Application()
        application.router.add_get("/", talk)
        runner = web.AppRunner(application, shutdown_timeout=0.1, handle_signals=False)
        await runner.setup()
        site = web.TCPSite(runner, "127.0.0.1", 0)
        await site.start()
        server.port = runner.addresses[0][1]
        return runner

    runner = loop.run_until_complete(begin())
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        yield server
    finally:
        asyncio.run_coroutine_threadsafe(runner.cleanup(), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
