"""The row of the audit trail for requests that no transaction has written one for.

A change writes its row in its own transaction (`Store.acting_for`). Here a refused request gets
its row, and a row whose answer turned out another way is corrected, before the answer goes out.
"""

from __future__ import annotations

from starlette.concurrency import run_in_threadpool
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.visit import Visit, visit_of
from service.errors import StoreAwayError
from service.handlers.audit import conclude, noted
from service.ports import Store


class Trail:
    """ASGI middleware: every state-changing request that came past the gate leaves a row."""

    def __init__(self, app: ASGIApp, store: Store) -> None:
        self.app = app
        self.store = store

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        visit = visit_of(scope)
        if visit is None:
            await self.app(scope, receive, send)
            return
        concluded = False

        async def concluding(message: Message) -> None:
            nonlocal concluded
            if message["type"] == "http.response.start" and not concluded:
                concluded = True
                await self._conclude(visit, message["status"])
            await send(message)

        try:
            await self.app(scope, receive, concluding)
        except Exception as error:
            if not concluded:
                away = isinstance(error, StoreAwayError)
                visit.problem = "database-away" if away else "internal-error"
                await self._conclude(visit, 503 if away else 500)
            raise

    async def _conclude(self, visit: Visit, status: int) -> None:
        if visit.act is not None and not noted(visit.act, status):
            await run_in_threadpool(conclude, self.store, visit.act, status, visit.problem)
