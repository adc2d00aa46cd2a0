"""The processes of a centre, each by its name."""

from collections.abc import Coroutine
from pathlib import Path

from shared.fleet.enrolling import fingerprint_of

from .centre import Centre

Work = Coroutine[object, object, None]


def work_of(name: str, centre: Centre) -> Work:
    """Give the work of a process, until it is cancelled; raises `UserError`."""
    return WORKS[name](centre)


def _admission(centre: Centre) -> Work:
    from .admission.process import serve

    return serve(centre, centre.dsn("admission"))


def _ingest(centre: Centre) -> Work:
    from .ingest.process import serve

    return serve(centre.nats("ingest"), centre.dsn("ingest"))


def _alarms(centre: Centre) -> Work:
    from .alarms.process import serve
    from .alarms.web_hook import AddressPolicy

    return serve(centre.nats("alarms"), centre.dsn("alarms"), AddressPolicy(centre.settings.web_hook_networks))


def _maintenance(centre: Centre) -> Work:
    from .database.maintenance import serve

    return serve(centre.owner_dsn, centre.database_passwords)


def _web(centre: Centre) -> Work:
    from .web.process import WebSettings, serve

    settings = centre.settings
    return serve(
        WebSettings(
            centre.dsn("web"),
            centre.nats("web"),
            enrol_url=centre.enrol_url,
            fingerprint=fingerprint_of(centre.authority_pem),
            host=settings.web_listen,
            port=settings.web_port,
            names=(settings.host, *settings.web_names),
            certificate=centre.web_certificate,
            web_hook_networks=settings.web_hook_networks,
            map_file=Path(settings.map_file) if settings.map_file else None,
        )
    )


WORKS = {
    "admission": _admission, "ingest": _ingest, "alarms": _alarms, "web": _web, "maintenance": _maintenance,
}  # fmt: skip
NAMES = tuple(WORKS)
# What their works import when they begin, and the command line that leads to them: imported once for all.
MODULES = (
    "cli.main", "cli.centre.centre", "fleet.admission.process", "fleet.ingest.process", "fleet.alarms.process",
    "fleet.alarms.web_hook", "fleet.database.maintenance", "fleet.web.process",
)  # fmt: skip
