"""Examples of what people use: a page, a command."""

from .recipe import Example
from .tree import Edit

DASHBOARD = "services/monitoring/status/dashboard"
MAIN, WORDS = f"{DASHBOARD}/main.js", f"{DASHBOARD}/words.js"
LISTED = '"recordings", "system"'

PAGE: Example = (
    (
        Edit(
            f"{DASHBOARD}/notes.js",
            """// The page Notes: the vehicle's name, as an example.
import { state } from "./store.js";
import { Card, html } from "./parts.js";
import { words } from "./words.js";

export function NotesPage() {
  return html`<${Card} title=${words.pages.notes}><p>${state.value?.vehicle ?? ""}</p></${Card}>`;
}
""",
        ),
    ),
    (
        Edit(MAIN, ' "notes",', after='const PAGES = ["now",'),
        Edit(MAIN, ' o: "notes",', after='const GO = { n: "now",'),
        Edit(MAIN, '  notes: () => import("./notes.js").then((m) => m.NotesPage),\n', after="const LATER = {\n"),
    ),
    (
        Edit(WORDS, ' notes: "Notes",', after='pages: { now: "Now",'),
        Edit(WORDS, '      ["g o", "Notes"],\n', after='      ["g n", "Now"],\n'),
    ),
    (
        Edit(
            f"{DASHBOARD}/parts.js",
            '  notes: html`<path d="M5 3h14v18H5zM8 8h8M8 12h8M8 16h5" class="line" />`,\n  now: html`',
            instead_of="  now: html`",
        ),
    ),
    (Edit("docs/reference/pages.md", "| *Notes* | the name of the vehicle |\n| *Map* |", instead_of="| *Map* |"),),
    (Edit("docs/picture.py", ' "notes",', after='("now", "map", "gnss", "charts", "trust",'),),
    (
        Edit("tests/browser/test_layout.py", ' "notes",', after='PAGES = ("now",'),
        Edit("tests/browser/test_page_errors.py", ' "notes",', after='PAGES = ("now",'),
    ),
)

COMMAND: Example = (
    (
        Edit(
            "cli/layers.py",
            '''"""`obu layers`: prints the layers of the unit."""

from shared.processes import LAYERS


def layers() -> int:
    """Print the layers of the unit, and what each does.

    Example: [bold]obu layers[/]
    """
    for number, (name, purpose) in enumerate(LAYERS.items(), 1):
        print(f"{number} {name}: {purpose}")
    return 0
''',
        ),
    ),
    (
        Edit(
            "cli/catalogue.py",
            '    Entry(LOOK, "layers", "Print the layers of the unit, and what each does."),\n',
            after='    Entry(LOOK, "tail"'
            + ', "Print the messages of a running unit as they are received, one per line."),\n',
        ),
        Edit("cli/catalogue.py", '    "layers": ("layers", "layers"),\n', after='    "enrol": ("enrol", "enrol"),\n'),
    ),
    (Edit("docs/how-to/upgrade.md", "\n`obu layers` prints the layers.\n", after="# Upgrade\n"),),
)

EXAMPLES = {"page": PAGE, "command": COMMAND}
