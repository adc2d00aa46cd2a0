"""The AsyncAPI document is one to AsyncAPI's own parser, which runs under node."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.main import command_line
from services.monitoring.status.page import DASHBOARD
from tests.support.patience import HANGS_S

# Reads documents as a JSON list of texts; prints for each the list of its errors.
SCRIPT = """
const { Parser } = require("@asyncapi/parser");
const documents = JSON.parse(require("node:fs").readFileSync(0, "utf8"));
const errors = async (text) => (await new Parser().parse(text)).diagnostics
  .filter((found) => found.severity === 0).map((found) => `${found.path.join("/")}: ${found.message}`);
Promise.all(documents.map(errors)).then((found) => console.log(JSON.stringify(found)));
"""


def test_asyncapis_own_parser_finds_no_error_but_a_reference_to_nothing() -> None:
    node = shutil.which("node", path=os.pathsep.join((os.environ.get("PATH", ""), str(Path(sys.executable).parent))))
    if node is None or not (DASHBOARD / "node_modules" / "@asyncapi" / "parser").is_dir():
        pytest.skip("node or @asyncapi/parser is missing: `python deploy/install_dashboard.py --testing`")
    document, of_centre = (CliRunner().invoke(command_line([]), ["schemas", name]).output for name in ("bus", "centre"))
    broken = of_centre.replace('"#/components/messages/Live"', '"#/$defs/Nothing"', 1)
    result = subprocess.run(
        [node, "-e", SCRIPT], cwd=DASHBOARD, input=json.dumps([document, of_centre, broken]), capture_output=True,
        text=True, timeout=HANGS_S, check=True,
    )  # fmt: skip
    of_document, of_link, of_broken = json.loads(result.stdout)
    assert (of_document, of_link) == ([], [])
    assert len(of_broken) == 1 and "'#/$defs/Nothing' does not exist" in of_broken[0]
