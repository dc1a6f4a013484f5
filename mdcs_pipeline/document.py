"""YAML text to a plain tree of values with line numbers; nothing is ever built from tags."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from mdcs_pipeline.errors import ConfigError, suggestion

MAX_BYTES = 1 << 18
MAX_DEPTH = 20
MAX_NODES = 20_000

_CORE = "tag:yaml.org,2002:"
_TEXT_TAGS = frozenset(_CORE + name for name in ("str", "timestamp", "value", "merge", "yaml"))
_SCALAR_TAGS = _TEXT_TAGS | {_CORE + name for name in ("int", "float", "bool", "null")}
_VARIABLE = re.compile(r"\$(\$?)\{([A-Za-z_][A-Za-z0-9_]*)(?::-([^}]*))?\}|\$\{")


class _Loader(yaml.SafeLoader):
    """The safe loader; it also reads 1e-3, which YAML 1.1 takes for text."""


class _FastLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """The same by libyaml, ten times faster, where PyYAML was built with it."""


for _kind in (_Loader, _FastLoader):
    _kind.add_implicit_resolver(
        _CORE + "float", re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+\Z"), list("-+0123456789")
    )


@dataclass(frozen=True)
class Place:
    """A line of a file; line 0 stands for the file as a whole."""

    file: str
    line: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}" if self.line else self.file


@dataclass(frozen=True)
class Branch:
    """A mapping, sequence or scalar of the document, and where it stands."""

    value: dict[str, Branch] | list[Branch] | str | int | float | bool | None
    place: Place

    def plain(self) -> Any:
        """Return the value without its places."""
        if isinstance(self.value, dict):
            return {key: branch.plain() for key, branch in self.value.items()}
        if isinstance(self.value, list):
            return [branch.plain() for branch in self.value]
        return self.value


def read_document(data: bytes, file: str, environment: Mapping[str, str]) -> Branch:
    """Return the tree of a YAML document.

    Parameters
    ----------
    data : bytes
        UTF-8.
    file : str
        Named in errors.
    environment : mapping
        Replaces ``${NAME}`` and ``${NAME:-default}`` in scalar values, after parsing, so
        that it never adds structure; ``$${NAME}`` stands for the text itself.

    Returns
    -------
    Branch

    Raises
    ------
    ConfigError
        If it is no YAML, too large or deep, has tags, duplicate keys or unset variables.
    """
    place = Place(file)
    if len(data) > MAX_BYTES:
        raise ConfigError(
            f"larger than {MAX_BYTES} bytes", where=str(place), received=f"{len(data)} bytes"
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError("not UTF-8 text", where=str(place), received=str(error)) from error
    return _Reader(file, environment).read(text)


def scalar_of(text: str) -> str | int | float | bool | None:
    """Return what `text` stands for as a plain YAML scalar, such as 3, 1e-3 or true."""
    loader = _Loader("")
    try:
        tag = loader.resolve(yaml.ScalarNode, text, (True, False))  # type: ignore[no-untyped-call]
        return _construct(loader, yaml.ScalarNode(tag, text))
    finally:
        loader.dispose()


def _construct(loader: _Loader, node: yaml.ScalarNode) -> str | int | float | bool | None:
    if node.tag in _TEXT_TAGS:
        return str(node.value)
    value: str | int | float | bool | None = loader.construct_object(node)
    return value


def _line(marked: yaml.Node | yaml.Event) -> int:
    return 0 if marked.start_mark is None else marked.start_mark.line + 1


class _Reader:
    """The walk over one document."""

    def __init__(self, file: str, environment: Mapping[str, str]) -> None:
        self.file = file
        self.environment = environment
        self.count = 0

    def read(self, text: str) -> Branch:
        try:
            try:
                node = self._composed(text, _FastLoader)
            except (yaml.YAMLError, ValueError, OverflowError):
                # What is wrong, and where, is for the plain one to say.
                node = self._composed(text, _Loader)
        except yaml.YAMLError as error:
            raise self._fault(error) from error
        except (ValueError, OverflowError) as error:
            # PyYAML lets escapes beyond Unicode fail in chr().
            raise ConfigError("not valid YAML", where=self.file, remedy=str(error)) from error
        if node is None:
            raise ConfigError("the document is empty", where=self.file)
        return self._branch(node, 0)

    def _composed(self, text: str, kind: type[Any]) -> yaml.Node | None:
        # Counted on the flat stream first: composing recurses, so depth must be known.
        self._check_depth(yaml.parse(text, Loader=kind))
        loader = kind(text)
        try:
            node: yaml.Node | None = loader.get_single_node()
        finally:
            loader.dispose()
        return node

    def _check_depth(self, events: Iterator[yaml.Event]) -> None:
        depth = 0
        for event in events:
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
            if depth > MAX_DEPTH:
                place = Place(self.file, _line(event))
                raise ConfigError(f"nested deeper than {MAX_DEPTH} levels", where=str(place))

    def _fault(self, error: yaml.YAMLError) -> ConfigError:
        mark = getattr(error, "problem_mark", None)
        line = 0 if mark is None else mark.line + 1
        parts = [getattr(error, name, None) for name in ("context", "problem", "reason")]
        problem = ", ".join(part for part in parts if part) or str(error)
        return ConfigError(f"not valid YAML: {problem}", where=str(Place(self.file, line)))

    def _branch(self, node: yaml.Node, depth: int) -> Branch:
        place = Place(self.file, _line(node))
        self.count += 1
        if self.count > MAX_NODES or depth > MAX_DEPTH:
            raise ConfigError(
                "aliases make the document too large or endless",
                where=str(place),
                remedy="write the values out",
            )
        if isinstance(node, yaml.ScalarNode) and node.tag in _SCALAR_TAGS:
            return Branch(self._scalar(node, place), place)
        if isinstance(node, yaml.SequenceNode) and node.tag == _CORE + "seq":
            return Branch([self._branch(item, depth + 1) for item in node.value], place)
        if isinstance(node, yaml.MappingNode) and node.tag == _CORE + "map":
            return Branch(self._mapping(node, depth), place)
        raise ConfigError(
            "tags that build objects are not allowed",
            where=str(place),
            received=node.tag,
            remedy="write a plain value, list or mapping",
        )

    def _mapping(self, node: yaml.MappingNode, depth: int) -> dict[str, Branch]:
        branches: dict[str, Branch] = {}
        lines: dict[str, int] = {}
        for key, value in node.value:
            line = _line(key)
            where = str(Place(self.file, line))
            if not isinstance(key, yaml.ScalarNode) or key.tag not in _SCALAR_TAGS:
                raise ConfigError("a key must be plain text", where=where, received=key.tag)
            name = str(key.value)
            if name in branches:
                raise ConfigError(
                    f"key '{name}' stands twice",
                    where=where,
                    received=f"first in line {lines[name]}",
                    remedy="keep one of them",
                )
            branch = self._branch(value, depth + 1)
            # A block value starts a line below its key; the key is what a reader looks for.
            branches[name] = Branch(branch.value, Place(self.file, line))
            lines[name] = line
        return branches

    def _scalar(self, node: yaml.ScalarNode, place: Place) -> str | int | float | bool | None:
        text = self._replaced(node.value, place)
        loader = _Loader("")
        try:
            text.encode()
            if text != node.value and not node.style:
                return scalar_of(text)
            return _construct(loader, yaml.ScalarNode(node.tag, text))
        except (ValueError, LookupError) as error:
            # LookupError: PyYAML's own for '!!int' of nothing and '!!bool' of a word.
            raise ConfigError(
                "a value that does not fit its type",
                where=str(place),
                received=ascii(node.value),
                remedy=str(error),
            ) from error
        finally:
            loader.dispose()

    def _replaced(self, text: str, place: Place) -> str:
        def value_of(match: re.Match[str]) -> str:
            escaped, name, default = match.groups()
            if name is None:
                raise ConfigError(
                    "a '${' that names no variable",
                    where=str(place),
                    received=text,
                    remedy="write ${NAME} or ${NAME:-default}",
                )
            if escaped:
                return match.group()[1:]
            value = self.environment.get(name) or default
            if value is None and name not in self.environment:
                raise ConfigError(
                    f"environment variable '{name}' is not set",
                    where=str(place),
                    received=text,
                    remedy=f"set it, or give a default: ${{{name}:-value}}",
                )
            return value or ""

        return _VARIABLE.sub(value_of, text)


def known_keys(branch: Branch, allowed: tuple[str, ...], what: str) -> dict[str, Branch]:
    """Return the entries of a mapping whose keys are all among `allowed`.

    Raises
    ------
    ConfigError
        If it is no mapping or has another key; the nearest right name is suggested.
    """
    entries = entries_of(branch, what)
    for key, value in entries.items():
        if key not in allowed:
            raise ConfigError(
                f"{what} has no key '{key}'",
                where=str(value.place),
                remedy=suggestion(key, allowed),
            )
    return entries


def entries_of(branch: Branch, what: str) -> dict[str, Branch]:
    """Return the entries of a mapping, or raise a `ConfigError` naming `what`."""
    if isinstance(branch.value, dict):
        return branch.value
    raise ConfigError(
        f"{what} must be a mapping",
        where=str(branch.place),
        received=branch.plain(),
        remedy="write 'key: value' lines",
    )


def text_of(branch: Branch, what: str) -> str:
    """Return the text of a scalar, or raise a `ConfigError` naming `what`."""
    if isinstance(branch.value, str) and branch.value:
        return branch.value
    raise ConfigError(f"{what} must be text", where=str(branch.place), received=branch.plain())
