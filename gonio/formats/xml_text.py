"""XML from anybody: its text is decoded first, so that no encoding hides what is refused in it."""

import codecs
import io
import re
from xml.etree import ElementTree

from gonio.errors import DataError
from gonio.shown import one_line

DEEPEST = 200
"""Most elements within each other."""
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
    (b"<\0", "utf-16-le"), (b"\0<", "utf-16-be"),
)  # fmt: skip
"""How XML begins that does not state its encoding in ASCII."""
_ENCODINGS = {"utf-8", "ascii", "iso8859-1", "cp1252", "utf-16"}
"""By their names in Python. Others, as UTF-7, write a `<` in other bytes."""


def decoded(data: bytes, where: str) -> str:
    """The text of an XML file, by its byte order mark or the encoding that it states; UTF-8 where it states none.

    Raises
    ------
    DataError
        It is in an encoding that is not read, or has bytes that are none of its encoding.
    """
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "")
    if not encoding:
        stated = re.match(rb"""\s*<\?xml[^>]{0,200}?encoding\s*=\s*["']([^"'>]{0,80})""", data)
        name = stated[1].decode("latin-1") if stated else "utf-8"
        try:
            encoding = codecs.lookup(name).name
        except (LookupError, ValueError):  # ValueError: of a zero byte
            encoding = ""
        if encoding not in _ENCODINGS:
            raise DataError(f"{where}: its encoding is {name!r}, which is not read; save it as UTF-8")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise DataError(f"{where}: byte {error.start} is no text in {encoding}; save it as UTF-8") from None


def require_plain(data: bytes, where: str) -> str:
    """The text of an XML file; `DataError` where it declares a document type or an entity, in whatever encoding."""
    text = decoded(data, where)
    if re.search(r"<!(DOCTYPE|ENTITY)", text):
        raise DataError(f"{where}: has a document type, or declares entities, which no such file needs")
    return text


def root(data: bytes, where: str) -> ElementTree.Element:
    """The tree of an XML file without a document type.

    Raises
    ------
    DataError
        It is no XML (with the line), has a document type, or elements within each other without end.
    """
    text = require_plain(data, where)
    depth = 0
    first: ElementTree.Element | None = None
    parser = ElementTree.XMLParser(encoding="utf-8")  # of the text as it is decoded, whatever it states
    try:
        for event, element in ElementTree.iterparse(io.BytesIO(text.encode()), ("start", "end"), parser):
            depth += 1 if event == "start" else -1
            first = element if first is None else first
            if depth > DEEPEST:
                raise DataError(f"{where}: has more than {DEEPEST} elements within each other")
    except ElementTree.ParseError as error:
        line, column = error.position
        said = str(error).partition(":")[0]
        raise DataError(f"{where}, line {line}, column {column + 1}: not valid XML: {said}") from None
    except ValueError as error:  # a lone surrogate, or what expat does not take
        raise DataError(f"{where}: not valid XML: {one_line(error, 100)}") from None
    if first is None:
        raise DataError(f"{where}: not valid XML: it is empty")
    return first
