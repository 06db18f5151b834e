"""Event documents as files: a line each, checked against the event model."""

import gzip
import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path

from gonio.disk import is_stream, require_name
from gonio.errors import ConfigError, DataError
from gonio.formats.reader import write_bytes
from gonio.lab.acquisition.run import Run
from gonio.typing import JsonObject
from gonio_bluesky.event_documents import Document, documents


def write(source: str, target: Path) -> list[str]:
    """Write the documents of a run, one JSON array `[kind, document]` a line; compressed where the name ends in .gz.

    Returns
    -------
    list of str
        What a reader should know: what is missing in the run, and whether the documents were checked.

    Raises
    ------
    ConfigError
        `source` is no run, or `target` cannot be written.
    DataError
        The run is damaged, or a document does not fit the event model; nothing is written then.
    """
    run = Run.open(source)
    if not len(run.events()):
        raise ConfigError(f"{source}: nothing has been measured in this run yet")
    require_name(target)
    if target.is_dir():
        raise ConfigError(f"{target}: is a folder; name the file to write, as {target / 'run.jsonl'}")
    check, remarks = _checker()
    counted = 0

    def lines() -> Iterator[bytes]:
        nonlocal counted
        for kind, document in documents(run, remarks):
            check(kind, document)
            counted += 1
            yield (json.dumps([kind, document], ensure_ascii=False, allow_nan=False) + "\n").encode()

    pieces = _packed(lines()) if target.suffix == ".gz" else lines()
    write_bytes(target, b"".join(pieces) if is_stream(target) else pieces)
    return [*remarks, f"{counted} documents"]


def _packed(lines: Iterator[bytes]) -> Iterator[bytes]:
    """Compressed with gzip, without name and time, so that the same run gives the same bytes."""
    held = io.BytesIO()
    with gzip.GzipFile("", "wb", fileobj=held, mtime=0) as out:
        for line in lines:
            out.write(line)
            yield held.getvalue()
            held.seek(0)
            held.truncate()
    yield held.getvalue()


def read(path: str | Path) -> Iterator[Document]:
    """The documents of a file that `write` has written, in their order.

    Raises
    ------
    ConfigError
        There is no such file.
    DataError
        It is damaged; the message names the line.
    """
    path = Path(path)
    number = 0
    try:
        with gzip.open(path, "rb") if path.suffix == ".gz" else path.open("rb") as file:
            for line in file:
                kind, document = json.loads(line)
                number += 1
                yield kind, document
    except OSError as error:
        if isinstance(error, gzip.BadGzipFile):
            raise DataError(f"{path}: is not compressed with gzip, or damaged") from None
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, EOFError) as error:
        raise DataError(f"{path}: line {number + 1}: is no document of a run: {error}") from None


def _checker() -> tuple[Callable[[str, JsonObject], None], list[str]]:
    """What refuses a document that does not fit the event model, and what to say where that is not installed."""
    try:
        from event_model import DocumentNames, basemodels, schema_validators
        from jsonschema import ValidationError
    except ImportError:
        how = 'pip install "gonio[bluesky]" brings it'
        return (lambda kind, document: None), [f"the documents are unchecked: event-model is not installed ({how})"]
    # fifty times as fast as the schemas
    many: JsonObject = {"event": basemodels.Event, "datum_page": basemodels.DatumPage}

    def check(kind: str, document: JsonObject) -> None:
        try:
            if kind in many:
                many[kind].model_validate(document, strict=True)
            else:
                schema_validators[DocumentNames[kind]].validate(document)
        except (ValueError, ValidationError) as error:
            raise DataError(f"a document ({kind}) does not fit the event model: {error}") from None

    return check, []
