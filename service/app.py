"""The application: `python -m service.serve`, or `uvicorn --factory service.app:create_app`."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from jobs.settings import Settings
from service import openapi, page, problems
from service.gate import Gate
from service.routes import (
    deliveries,
    events,
    job_actions,
    jobs,
    metrics,
    results,
    samples,
    scans,
    slices,
    system,
    tickets,
    udf,
    uploads,
)
from service.services import running
from service.settings import ServiceSettings, from_environment
from service.traffic import Traffic, Watched
from udflow import __version__

DESCRIPTION = (
    "Point clouds to meshes and unsigned distances. Upload a scan, start a job, follow its events, "
    "fetch the mesh, ask for distances. Errors are RFC 9457 problem details with a stable `code`."
)


def create_app(settings: ServiceSettings | None = None, shared: Settings | None = None) -> FastAPI:
    """The application.

    Args:
        settings: of the front door; default: from the environment.
        shared: what service and worker share; default: from the environment.

    Raises:
        SettingsError, BadSetting: the environment cannot be used.
        NoRedisServer: REDIS_URL is not set (when the application starts).
    """
    front = settings or from_environment()
    common = shared or Settings.from_env()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with running(front, common) as services:
            app.state.services = services
            yield

    app = FastAPI(
        title="udflow",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,  # the usual pages load scripts from elsewhere
        redoc_url=None,
        redirect_slashes=False,
    )
    problems.install(app)
    for part in (
        *(scans, uploads, samples, jobs, job_actions, events, results, udf, slices, system),
        deliveries,
        tickets,
        metrics,
        page,
    ):
        app.include_router(part.router)
    app.openapi = lambda: openapi.document(app)  # type: ignore[method-assign]
    app.add_middleware(Gate, settings=front)
    app.state.traffic = Traffic()
    app.add_middleware(Watched, traffic=app.state.traffic)
    return app
