"""What APIs answer, as models: they are the schemas of /openapi.json, and tests hold every answer to them."""

from collections.abc import Iterator
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict
from pydantic.json_schema import models_json_schema

REFERENCE = "#/components/schemas/{model}"
Stamp = int  # [ns] on the OBU time line, which is UTC as nanoseconds since 1970
Object = dict[str, Any]  # described by asyncapi.json, or by no contract


class Answer(BaseModel):
    """An answer, of which every field is described."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True, defer_build=True)
    example: ClassVar[Object | None] = None


class Refusal(Answer):
    """Why a request was refused, and what to try."""

    detail: str
    example: ClassVar = {"detail": "there is no topic gnss/colour; /api/state lists them"}


def file_of(media_type: str, text: str) -> Object:
    """Describe an answer that is a file."""
    return {"description": text, "content": {media_type: {"schema": {"type": "string"}}}}


def schemas(*others: type[BaseModel]) -> Object:
    """Give the schemas of all answers, and of other models, by name; they are built when somebody asks for them."""
    models = [*_below(Answer), *others]
    _, found = models_json_schema([(model, "validation") for model in models], ref_template=REFERENCE)
    definitions = found["$defs"]
    assert isinstance(definitions, dict)
    return definitions


def _below(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    for child in model.__subclasses__():
        yield child
        yield from _below(child)


def reference_to(model: type[BaseModel]) -> Object:
    """Refer to the schema of a model."""
    return {"$ref": REFERENCE.format(model=model.__name__)}


def described(model: type[Answer], text: str, media_type: str = "application/json") -> Object:
    """Describe an answer of a route: its schema, and an example where there is one."""
    example = {} if model.example is None else {"example": model.example}
    return {"description": text, "content": {media_type: {"schema": reference_to(model), **example}}}
