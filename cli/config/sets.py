"""`obu config begin`: a vehicle's file from a set of hardware."""

from pathlib import Path
from typing import Annotated

import typer

from shared.errors import UserError
from shared.settings.edit import checked, edited
from shared.settings.sets import hardware_sets

from ..output_file import insist_on_new, write_text


def begin(
    name: Annotated[
        str | None, typer.Argument(metavar="SET", help="Name of a set; without it they are listed.")
    ] = None,
    *,
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FILE", help="The vehicle's file, which must not be there.")
    ] = Path("vehicle.toml"),
    vehicle_name: Annotated[str, typer.Option("--name", metavar="NAME", help="Name of the vehicle.")] = "car",
) -> int:
    """Write a vehicle's file for a set of hardware, from which its set-up goes on.

    Examples:
    [bold]obu config begin[/]
    [bold]obu config begin f9p_xsens --name van-3 --out van.toml[/]
    """
    files = {one.name: one.text for one in hardware_sets()}
    if name is None:
        for one in hardware_sets():
            print(f"{one.name:14} {one.what}")
        return 0
    if name not in files:
        raise UserError(f"there is no set {name!r}; `obu config begin` lists {', '.join(files)}")
    insist_on_new(out)
    text = edited(files[name], {"vehicle.name": vehicle_name})
    checked(text, str(out))
    write_text(out, text)
    print(f"wrote {out}; the page Set up goes on from it, or `obu set-up` with a recorded drive")
    return 0
