"""What the description of the API says, without its words: OpenAPI that means the same reads the same."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from robotether_server.api.description import document
from syrupy.assertion import SnapshotAssertion

SCHEMA = "#/components/schemas/"
PARAMETER = "#/components/parameters/"
WORDS = ("title", "description", "examples", "discriminator")
Schema = dict[str, Any]


class Reader:
    """Writes each schema in one way, with what it refers to in its place."""

    def __init__(self, api: dict[str, Any]) -> None:
        self._components = api["components"]

    def schema(self, given: Schema) -> Schema:
        """Return the same schema without references, words and unions that a list of types can say."""
        if "$ref" in given:
            name = given["$ref"].removeprefix(SCHEMA)
            if name == "Problem":
                return {"$ref": name}
            beside = {key: value for key, value in given.items() if key != "$ref"}
            return self.schema(self._components["schemas"][name] | beside)
        if "allOf" in given and all("oneOf" not in item for item in given["allOf"]):
            return self._joined([self.schema(item) for item in given["allOf"]])
        found = {key: value for key, value in given.items() if key not in WORDS}
        for union in {"anyOf", "oneOf"} & set(found):
            found |= self._union([self.schema(item) for item in found.pop(union)])
        return self._inner(self._keywords(found))

    def _keywords(self, found: Schema) -> Schema:
        """Write lists of names in order, and leave out what says nothing."""
        if "const" in found:
            found["enum"] = [found.pop("const")]
        for key in {"required", "enum"} & set(found):
            found[key] = sorted(found[key], key=repr)
        if not found.get("required", True):
            del found["required"]
        return found

    def _inner(self, found: Schema) -> Schema:
        if "properties" in found:
            found["properties"] = {k: self.schema(v) for k, v in found["properties"].items()}
        for key in ("items", "additionalProperties", "contentSchema"):
            if isinstance(found.get(key), dict):
                found[key] = self.schema(found[key])
        return found

    def _union(self, options: list[Schema]) -> Schema:
        nothing = {"type": "null"}
        others = [option for option in options if option != nothing]
        if nothing not in options:
            # One of them fits, and no more: their members differ.
            return {"oneOf": sorted(others, key=repr)}
        [other] = others
        if "enum" in other:
            return other | {"enum": [*other["enum"], None]}
        return other | {"type": [other["type"], "null"]}

    def _joined(self, parts: list[Schema]) -> Schema:
        whole: Schema = {"type": "object", "properties": {}, "required": []}
        for part in parts:
            whole["properties"] |= part["properties"]
            whole["required"] += part.get("required", [])
        return whole | {"required": sorted(whole["required"])}

    def parameter(self, given: dict[str, Any]) -> str:
        """Return one parameter as a line."""
        if "$ref" in given:
            given = self._components["parameters"][given["$ref"].removeprefix(PARAMETER)]
        required = "required" if given.get("required") else "optional"
        return f"{given['in']} {given['name']} {required} {line(self.schema(given['schema']))}"

    def content(self, given: dict[str, Any]) -> list[str]:
        """Return what a body may be, a line for each type."""
        return [
            f"{kind} {line(self.schema(item['schema']))}" for kind, item in sorted(given.items())
        ]


def line(schema: Schema) -> str:
    return json.dumps(schema, sort_keys=True, ensure_ascii=False)


def operation(reader: Reader, shared: list[Any], given: dict[str, Any]) -> list[str]:
    """Return what an operation takes and answers."""
    lines = [f"{given['operationId']}: {given['summary']}"]
    lines += [f"{key} {given[key]}" for key in ("tags", "security") if given.get(key) is not None]
    lines += sorted(reader.parameter(item) for item in [*shared, *given.get("parameters", [])])
    if "requestBody" in given:
        required = "required" if given["requestBody"].get("required") else "optional"
        lines += [
            f"body {required} {item}" for item in reader.content(given["requestBody"]["content"])
        ]
    for status, answer in sorted(given["responses"].items()):
        if "$ref" in answer:
            lines.append(f"{status} {answer['$ref'].rpartition('/')[2]}")
        else:
            lines += [
                f"{status} {item}" for item in reader.content(answer.get("content", {})) or [""]
            ]
    return [text.rstrip() for text in lines]


def described(api: dict[str, Any]) -> Iterator[str]:
    """Yield the whole description, line by line."""
    reader, components = Reader(api), api["components"]
    for key in ("openapi", "servers", "security"):
        yield f"{key} {line(api[key])}"
    yield f"license {line(api['info']['license'])}"
    yield f"tags {', '.join(tag['name'] for tag in api['tags'])}"
    for name, scheme in sorted(components["securitySchemes"].items()):
        yield f"{name} {line({k: v for k, v in scheme.items() if k not in WORDS})}"
    for name, answer in sorted(components["responses"].items()):
        yield f"{name} {' '.join(reader.content(answer['content']))}"
    yield f"Problem {line(reader.schema(components['schemas']['Problem']))}"
    for path, item in sorted(api["paths"].items()):
        for method in sorted(set(item) - {"parameters"}):
            yield f"\n{method.upper()} {path}"
            for text in operation(reader, item.get("parameters", []), item[method]):
                yield f"  {text}"


def test_description_of_the_api(recorded: SnapshotAssertion) -> None:
    """Each operation with its parameters, body and answers."""
    assert "\n".join(described(document())) + "\n" == recorded
