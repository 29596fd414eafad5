"""uvicorn, as the service runs it."""

from __future__ import annotations

import socket

import uvicorn
from fastapi import FastAPI

from service.api.waiting import Changes
from service.settings import Settings


class Server(uvicorn.Server):
    """Lets long polls and streams go as soon as a signal asked to stop.

    Not in the signal's handler: that may run while the same thread holds the very lock that it
    would need, and wait for ever.
    """

    changes: Changes | None = None

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        if self.changes is not None:
            self.changes.begin_close()
        await super().shutdown(sockets)


def server(app: FastAPI, settings: Settings) -> Server:
    """A server of the application at the settings' address."""
    config = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        headers=[("Server", "bladetwin")],
        timeout_graceful_shutdown=5,
    )
    made = Server(config)
    made.changes = app.state.services.changes
    return made
