"""What APIs answer, as typed dictionaries: views return them, FastAPI checks, prints and describes them."""

import sys
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from fastapi import Depends, Response
from pydantic import ConfigDict, TypeAdapter, with_config
from typing_extensions import TypedDict

# FastAPI asks of each route whether its models are those of pydantic 1, and would import it: 6 MB of each process.
sys.modules.setdefault("pydantic.v1", None)  # type: ignore[arg-type]  # None: a name that cannot be imported
REFERENCE = "#/components/schemas/{model}"
Stamp = int  # [ns] on the OBU time line, which is UTC as nanoseconds since 1970
Object = dict[str, Any]  # described by /asyncapi.json, or by no contract
Responses = dict[int | str, dict[str, Any]]  # of a route, by status, as FastAPI takes them
T = TypeVar("T")


def answer(example: Any = None, *, closed: bool = True) -> Callable[[type[T]], type[T]]:
    """Make a typed dictionary an answer: its docstrings are descriptions; `closed`: it has no other keys."""
    return with_config(
        ConfigDict(
            extra="forbid" if closed else "allow",
            use_attribute_docstrings=True,
            json_schema_extra={} if example is None else {"examples": [example]},
        )
    )


@answer({"detail": "there is no topic gnss/colour; /api/state lists them"})
class Refusal(TypedDict):
    """Why a request was refused, and what to try."""

    detail: str


@answer()
class AcceptedRequest(TypedDict):
    """The request was taken; what follows from it is in the state."""


async def _not_kept(response: Response) -> None:
    response.headers["Cache-Control"] = "no-store"


NOT_KEPT = [Depends(_not_kept)]  # of an application: no browser keeps what its routes answer


def refusals(texts: Mapping[int, str]) -> Responses:
    """Describe the refusals of a route by their status."""
    return {status: described(Refusal, text) for status, text in texts.items()}


def described(model: type, text: str, media_type: str = "application/json") -> Object:
    """Describe an answer beside the good one by a reference: FastAPI would build a checker of each, in every route."""
    return {"description": text, "content": {media_type: {"schema": reference_to(model)}}}


def file_of(media_type: str, text: str) -> Object:
    """Describe an answer that is a file."""
    return {"description": text, "content": {media_type: {"schema": {"type": "string"}}}}


def schemas(*models: type) -> Object:
    """Give the schemas of models by name; they are built when somebody asks for them."""
    inputs: list[Any] = [(model.__name__, "validation", TypeAdapter(model)) for model in models]
    _, found = TypeAdapter.json_schemas(inputs, ref_template=REFERENCE)
    definitions = found["$defs"]
    assert isinstance(definitions, dict)
    return definitions


def reference_to(model: type) -> Object:
    """Refer to the schema of a model."""
    return {"$ref": REFERENCE.format(model=model.__name__)}
