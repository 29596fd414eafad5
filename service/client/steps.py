"""A call of the API as steps, without a connection: written once, walked by two clients.

A call is a generator. It yields a `Call` (a request to send) or a `Pause` and is sent the answer;
what it returns is the result. `Walk` takes it step by step, so that a client adds no more than how
it sends and how it waits, and both know every call by the same words:

    def rotor(rotor: str) -> Steps[Json]:
        return ask("GET", path("rotors", rotor))

A transport's error is thrown into the generator, which may try again or let it pass. `call`,
`pages` and `stream` make methods of such functions: of a `Blocking` client they return the result,
of an `Awaiting` one something to await or to iterate over with ``async for``.
"""

from __future__ import annotations

from collections.abc import (
    AsyncIterator,
    Callable,
    Coroutine,
    Generator,
    Iterator,
    Mapping,
)
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, Generic, ParamSpec, TypeVar, overload
from urllib.parse import quote

import httpx

from service.client.errors import ProblemError

Json = dict[str, Any]
P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Call:
    """A request. `silence_s`: of a stream, without even a heartbeat the connection is lost."""

    method: str
    path: str
    params: Mapping[str, str] = field(default_factory=dict)
    json: Any = None
    content: bytes | None = None
    headers: Mapping[str, str] = field(default_factory=dict)
    silence_s: float = 60.0

    def request(self) -> dict[str, Any]:
        """What `httpx.Client.request` takes for it."""
        told: dict[str, Any] = {"method": self.method, "url": self.path, "headers": self.headers}
        told |= {"params": self.params} if self.params else {}
        told |= {} if self.json is None else {"json": self.json}
        return told | ({} if self.content is None else {"content": self.content})


@dataclass(frozen=True, slots=True)
class Pause:
    """Nothing to send for so long."""

    seconds: float


Step = Call | Pause
Steps = Generator[Step, Any, T]


class Walk(Generic[T]):
    """Takes a call step by step; `value` is its result once there is no step left.

    >>> walk = Walk(one(lambda answer: answer + 1, Call("GET", "/x")))
    >>> walk.go().path, walk.go(41), walk.value
    ('/x', None, 42)
    """

    value: T

    def __init__(self, steps: Steps[T]) -> None:
        self._steps = steps

    def go(self, answer: Any = None) -> Step | None:
        """The next step, given what the last one brought."""
        return self._next(lambda: self._steps.send(answer))

    def fail(self, error: Exception) -> Step | None:
        """The next step after one that failed; raises the error where the call has none."""
        return self._next(lambda: self._steps.throw(error))

    def _next(self, step: Callable[[], Step]) -> Step | None:
        try:
            return step()
        except StopIteration as end:
            self.value = end.value
            return None


def checked(response: httpx.Response) -> httpx.Response:
    """The answer; ProblemError where the service refused, or a proxy sends elsewhere."""
    if not response.is_success:
        raise ProblemError(response)
    return response


def wait_s(response: httpx.Response) -> float:
    """How long a service that has too many requests asks to wait."""
    try:
        return min(60.0, max(0.0, float(response.headers["retry-after"])))
    except (KeyError, ValueError):
        return 1.0


def one(read: Callable[[Any], T], asked: Call) -> Steps[T]:
    """A call of one request; `read` makes its result of the answer."""
    return read((yield asked))


def ask(method: str, where: str, **given: Any) -> Steps[Any]:
    """A call that is answered with a JSON object; its type is in `service.client.answers`."""

    def read(response: httpx.Response) -> Any:
        return checked(response).json()

    return one(read, Call(method, where, **given))


def fetch(where: str, params: Mapping[str, str]) -> Steps[bytes]:
    """A call that is answered with a file."""
    return one(lambda response: checked(response).content, Call("GET", where, params))


def part(steps: Steps[Any], name: str) -> Steps[Any]:
    """A call of whose answer one field matters."""
    return (yield from steps)[name]


def head_seq(steps: Steps[Any]) -> Steps[int]:
    """A call that appends to the log; the sequence number to wait for."""
    return int((yield from steps)["head_seq"])


def path(*parts: str) -> str:
    return "/v1/" + "/".join(quote(one, safe="") for one in parts)


def told(**given: object) -> dict[str, str]:
    """The query of what was given; numbers are exact.

    >>> told(count=3, time_h=0.1, blade=None, newest=True)
    {'count': '3', 'time_h': '0.1', 'newest': 'true'}
    """
    return {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in given.items()
        if value is not None
    }


class Blocking:
    """A client that returns what it was asked for."""

    def _run(self, steps: Steps[T]) -> T:
        raise NotImplementedError

    def _pages(self, first: Call) -> Iterator[Json]:
        raise NotImplementedError

    def _stream(self, asked: Call) -> Iterator[Json]:
        raise NotImplementedError


class Awaiting:
    """A client that returns what to await."""

    async def _run(self, steps: Steps[T]) -> T:
        raise NotImplementedError

    def _pages(self, first: Call) -> AsyncIterator[Json]:
        raise NotImplementedError

    def _stream(self, asked: Call) -> AsyncIterator[Json]:
        raise NotImplementedError


class call(Generic[P, T]):
    """A method of a function that gives steps."""

    def __init__(self, steps: Callable[P, Steps[T]]) -> None:
        self.steps = steps

    @overload
    def __get__(self, twin: None, owner: type) -> Callable[P, Steps[T]]: ...
    @overload
    def __get__(self, twin: Blocking, owner: type) -> Callable[P, T]: ...
    @overload
    def __get__(self, twin: Awaiting, owner: type) -> Callable[P, Coroutine[Any, Any, T]]: ...
    def __get__(self, twin: Any, owner: type) -> Any:
        if twin is None:
            return self.steps

        @wraps(self.steps)
        def bound(*args: P.args, **kw: P.kwargs) -> Any:
            return twin._run(self.steps(*args, **kw))

        return bound


class pages(Generic[P, T]):
    """A method of a function that gives the request for a first page; yields items of a type."""

    through = "_pages"

    def __init__(self, first: Callable[P, Call], of: type[T]) -> None:
        self.first, self.of = first, of

    @overload
    def __get__(self, twin: None, owner: type) -> Callable[P, Call]: ...
    @overload
    def __get__(self, twin: Blocking, owner: type) -> Callable[P, Iterator[T]]: ...
    @overload
    def __get__(self, twin: Awaiting, owner: type) -> Callable[P, AsyncIterator[T]]: ...
    def __get__(self, twin: Any, owner: type) -> Any:
        if twin is None:
            return self.first

        @wraps(self.first)
        def bound(*args: P.args, **kw: P.kwargs) -> Any:
            return getattr(twin, self.through)(self.first(*args, **kw))

        return bound


class stream(pages[P, T]):
    """A method of a function that gives the request for a stream of events; yields them."""

    through = "_stream"
