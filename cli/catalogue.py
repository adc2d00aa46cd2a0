"""The commands of `obu`: what its help prints, and where each command is.

Constants, so that the help, the version and a wrong name need no command, and no library.
"""

from dataclasses import dataclass
from textwrap import fill

ABOUT = "A vehicle on-board unit: position, velocity and attitude of the vehicle, with their integrity."
WIDTH = 100  # [characters] of the help
COLUMN = 16  # [characters] before the summary of a command


@dataclass(frozen=True)
class Entry:
    """One command, or group of commands: the heading below which the help lists it, and its first sentence."""

    heading: str
    name: str
    summary: str


TRY, RUN, LOOK, RECORDINGS, FLEET, SAFE = "Try", "Run", "Look", "Recordings", "Fleet", "Keep safe"
ENTRIES = (
    Entry(TRY, "demo", "Run the whole unit here with simulated sensors: no Docker, no hardware, no account."),
    Entry(
        TRY, "attack-lab",
        "Attack simulated and recorded drives; write report.html and report.json with rates of detection and false "
        "alarm.",
    ),
    Entry(TRY, "papers", "Reproduce what the published papers report."),
    Entry(RUN, "up", "Run every process of a unit under a small supervisor, on the broker of OBU_BROKER."),
    Entry(RUN, "run", "Run one process."),
    Entry(RUN, "broker", "Run the broker of a unit on this machine, reachable from here only, until Ctrl-C."),
    Entry(
        RUN, "command",
        "Send a command to the unit that runs on this computer, and print whether it is accepted, done or failed.",
    ),
    Entry(
        RUN, "set-up",
        "Measure mounting, lever arm, delays and odometer scale from a drive, and propose settings.",
    ),
    Entry(RUN, "calibrate", "Learn settings of the unit from recorded drives."),
    Entry(RUN, "config", "List, read and change the settings of a vehicle's file, and take changes back."),
    Entry(RUN, "migrate", "Rewrite a vehicle's file of an earlier version; comments and order stay."),
    Entry(
        LOOK, "doctor", "Check this machine, its configuration and a running unit, and name the remedy of each fault."
    ),
    Entry(
        LOOK, "support",
        "Collect what somebody who helps needs: checks, settings without secrets, health, logs, the last minutes.",
    ),
    Entry(LOOK, "tail", "Print the messages of a running unit as they are received, one per line."),
    Entry(
        LOOK, "topics",
        "Print the contract of the bus: topics, or processes; `obu schemas bus` prints the messages as well.",
    ),
    Entry(
        LOOK, "schemas",
        "Print the description of an interface for programs, with the schema of every message or answer.",
    ),
    Entry(RECORDINGS, "record", "Record every message of a running unit, beside its own recorder."),
    Entry(
        RECORDINGS, "import",
        "Convert files of devices or tables (CSV, text, NumPy .npz, MATLAB .mat) of a drive to a recording.",
    ),
    Entry(
        RECORDINGS, "solve",
        "Process a recording with the whole unit; write solution.csv, solution.kml, metrics.json and report.html.",
    ),
    Entry(
        RECORDINGS, "replay",
        "Show a recording in a dashboard: play, pause, speed, and any position of the drive.",
    ),
    Entry(
        RECORDINGS, "kpi",
        "Compute accuracy, availability, continuity, integrity, geometry and times of a drive.",
    ),
    Entry(
        RECORDINGS, "export",
        "Write a recording for other tools: tables, tracks, NMEA 0183, or raw measurements as RINEX 3.05.",
    ),
    Entry(
        FLEET, "enrol",
        "Make this unit known to a control centre, or show its enrolment when called without arguments.",
    ),
    Entry(FLEET, "centre", "Run and manage a control centre, to which vehicles report."),
    Entry(FLEET, "fleet", "Many recordings, and many vehicles, by one command."),
    Entry(
        SAFE, "keys",
        "Make and manage the secrets with which processes and programs identify themselves to the broker.",
    ),
    Entry(
        SAFE, "token",
        "Decide who may open the page of the unit whose state is in OBU_STATE, and what they may do.",
    ),
    Entry(
        SAFE, "backup",
        "Keep what makes this unit this unit: its settings, what it has learned, its keys, enrolment and logins.",
    ),
    Entry(
        SAFE, "restore",
        "Make this machine the unit of a backup; what it replaces is kept beside it, with `.old` at the end.",
    ),
    Entry(
        SAFE, "reset",
        "Put the unit back to how it was delivered: shipped settings, no logins, nothing learned.",
    ),
    Entry(SAFE, "evidence-key", "The key with which this unit signs recordings and charges."),
    Entry(
        SAFE, "verify",
        "Check the signatures of recordings, then feed each process what it consumed and compare its messages "
        "bytewise.",
    ),
    Entry(
        SAFE, "verify-set-up",
        "Check the signature of a certificate of an installation, and print what it says.",
    ),
    Entry(
        SAFE, "verify-toll",
        "Derive each charge again from its evidence, compare it bit for bit, and check chain and signatures.",
    ),
)  # fmt: skip
SUMMARY = {entry.name: entry.summary for entry in ENTRIES}
HIDDEN = ("reference",)  # of developers, through `make docs`
NAMES = (*SUMMARY, *HIDDEN)

# Module and function of each command, below cli/.
COMMANDS = {
    "demo": ("commands.unit", "demo"),
    "up": ("commands.unit", "up"),
    "broker": ("commands.unit", "broker"),
    "run": ("commands.unit", "run"),
    "topics": ("commands.look", "topics"),
    "schemas": ("commands.look", "schemas"),
    "tail": ("commands.look", "tail"),
    "command": ("commands.look", "command"),
    "doctor": ("commands.look", "doctor"),
    "reference": ("commands.look", "reference"),
    "support": ("support", "support"),
    "backup": ("backup", "backup"),
    "restore": ("backup", "restore"),
    "reset": ("backup", "reset"),
    "import": ("import_drive.import_drive", "import_drive"),
    "solve": ("solve.solve", "solve"),
    "kpi": ("kpi.kpi", "kpi"),
    "kpi ttff": ("kpi.first_fix", "first_fix"),  # beside a command that has an argument
    "attack-lab": ("attack_lab.attack_lab", "attack_lab"),
    "replay": ("recordings.replay", "replay"),
    "export": ("export.export", "export"),
    "verify": ("recordings.verify", "verify"),
    "verify-toll": ("verify_toll", "verify_toll"),
    "migrate": ("migrate", "migrate"),
    "config begin": ("config.sets", "begin"),
    "config list": ("config.config", "list_settings"),
    "config get": ("config.config", "get"),
    "config set": ("config.config", "set_values"),
    "config unset": ("config.config", "unset"),
    "config diff": ("config.config", "diff"),
    "config history": ("config.config", "history"),
    "config undo": ("config.config", "undo"),
    "enrol": ("enrol", "enrol"),
    "centre up": ("centre.centre", "up"),
    "centre run": ("centre.centre", "run"),
    "centre prepare": ("centre.centre", "prepare"),
    "centre token": ("centre.vehicles", "token"),
    "centre tokens": ("centre.vehicles", "tokens"),
    "centre vehicles": ("centre.vehicles", "vehicles"),
    "centre revoke": ("centre.vehicles", "revoke"),
    "centre erase": ("centre.vehicles", "erase"),
    "centre retain": ("centre.vehicles", "retain"),
    "centre tenant add": ("centre.tenants", "tenant_add"),
    "centre tenant list": ("centre.tenants", "tenant_list"),
    "centre tenant retention": ("centre.tenants", "tenant_retention"),
    "centre tenant budget": ("centre.tenants", "tenant_budget"),
    "centre tenant web-hook": ("centre.tenants", "tenant_web_hook"),
    "centre account add": ("centre.tenants", "account_add"),
    "centre account list": ("centre.tenants", "account_list"),
    "centre account disable": ("centre.tenants", "account_disable"),
    "fleet run": ("fleet.run", "run"),
    "fleet simulate": ("fleet.simulate", "simulate"),
    "evidence-key show": ("evidence_key", "show"),
    "evidence-key rotate": ("evidence_key", "rotate"),
    "evidence-key export": ("evidence_key", "export"),
    "papers list": ("commands.papers", "listed"),
    "papers navigation": ("commands.papers", "navigation"),
    "papers motion-conflict": ("commands.papers", "motion_conflict"),
    "papers cooperative": ("commands.papers", "cooperative"),
    "papers spoofing": ("commands.papers", "spoofing"),
    "papers toll": ("commands.papers", "toll"),
    "set-up": ("set_up.set_up", "set_up"),
    "verify-set-up": ("set_up.certificate", "verify_set_up"),
    "calibrate imu": ("calibrate.imu", "calibrate_imu"),
    "calibrate spoofing": ("calibrate.spoofing", "calibrate_spoofing"),
    "token list": ("token", "list_tokens"),
    "token add": ("token", "add_token"),
    "token revoke": ("token", "revoke_token"),
    "token show-link": ("token", "show_link"),
    "record": ("commands.record", "record"),  # a group that is a command as well
    "record repair": ("recordings.record", "repair"),
    "keys make": ("commands.keys", "make"),
    "keys list": ("commands.keys", "list_users"),
    "keys add": ("commands.keys", "add"),
    "keys remove": ("commands.keys", "remove"),
    "keys tls": ("commands.keys", "tls"),
    "keys rotate": ("commands.keys", "rotate"),
}
# What the help of a group says after its summary; without one the group is a command as well.
GROUPS = {
    "papers": "Examples:\n[bold]obu papers list[/]\n[bold]obu papers navigation --runs 2[/]",
    "config": "Each setting has a name of its section and its key; docs/reference/configuration.md lists them.\n\n"
    "Examples:\n[bold]obu config list --changed[/]\n[bold]obu config set core.fusion.gnss.delay_s=0.08[/]\n"
    "[bold]obu config undo[/]",
    "calibrate": "Example: [bold]obu calibrate spoofing drive.mcap -o profile.json[/]",
    "evidence-key": "Example: [bold]obu evidence-key export -o car.pub[/]",
    "token": "A token is shown once, when it is made; the unit keeps its hash only. A running unit sees changes at "
    "once.\n\nExamples:\n[bold]obu token show-link[/]\n[bold]obu token add workshop --role view[/]\n"
    "[bold]obu token revoke workshop[/]",
    "centre": "Example: [bold]obu centre up[/]",
    "centre tenant": "Tenants: each sees its own vehicles only.\n\nExample: [bold]obu centre tenant list[/]",
    "centre account": "Accounts for the pages of the centre.\n\n"
    "Example: [bold]obu centre account add anna --role admin[/]",
    "fleet": "Example: [bold]obu fleet run solve drives/ --out solved[/]",
    "keys": "Example: [bold]obu keys add fleet-gateway --read[/]",
    "record": "",
}


def help_text() -> str:
    """Print the commands below their headings."""
    lines = ["Usage: obu COMMAND [OPTIONS]", "", ABOUT]
    for heading in dict.fromkeys(entry.heading for entry in ENTRIES):
        lines += ["", heading]
        for entry in ENTRIES:
            if entry.heading == heading:
                first = f"  {entry.name}".ljust(COLUMN)
                lines.append(fill(entry.summary, WIDTH, initial_indent=first, subsequent_indent=" " * COLUMN))
    return "\n".join((
        *lines,
        "",
        "Options",
        "  --help        Print this help, or after a command that of the command.",
        "  --version     Print the version and exit.",
        "  --install-completion, --show-completion",
        "                Install completion of commands in this shell, or print it.",
        "",
        "Begin with `obu demo`. The help of each command has examples, such as `obu solve --help`.",
    ))  # fmt: skip
