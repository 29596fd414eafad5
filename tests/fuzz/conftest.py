"""The wired service of tests/service."""

from tests.service.conftest import (  # noqa: F401
    api,
    key,
    post,
    reading,
    rotor,
    science,
    server,
    serving,
    settings,
    store,
    worker,
)
