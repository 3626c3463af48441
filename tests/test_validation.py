"""Text that people's tools write: byte order marks, UTF-16, and JSON that does not parse."""

import codecs
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, Field

from pcore.errors import SceneError
from pcore.validation import parse, read_json

TEXT = '{"name": "Gerät", "frames": [1, 2]}'
ENCODED = {
    "UTF-8": TEXT.encode(),
    "UTF-8 with a mark": TEXT.encode("utf-8-sig"),
    "UTF-16 as Notepad writes it": codecs.BOM_UTF16_LE + TEXT.encode("utf-16-le"),
    "UTF-16, big end first": codecs.BOM_UTF16_BE + TEXT.encode("utf-16-be"),
    "UTF-16 without a mark": TEXT.encode("utf-16-le"),
    "UTF-16 without a mark, big end first": TEXT.encode("utf-16-be"),
    "UTF-32": codecs.BOM_UTF32_LE + TEXT.encode("utf-32-le"),
    "two marks": codecs.BOM_UTF8 + TEXT.encode("utf-8-sig"),
    "old Mac and Windows line ends": TEXT.replace(", ", ",\r\n\r").encode("utf-8-sig"),
}
PYTHON = ("codec", "utf-8-sig", "char ", "Errno", "Expecting", "delimiter", "None", "JSONDecode")


def read(path: Path, content: bytes) -> Any:
    path.write_bytes(content)
    return read_json(path, what="scene file", error=SceneError)


@pytest.mark.parametrize("kind", ENCODED)
def test_encodings_that_editors_write_are_read(tmp_path: Path, kind: str) -> None:
    assert read(tmp_path / "a.json", ENCODED[kind]) == {"name": "Gerät", "frames": [1, 2]}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (TEXT.encode("latin-1"), r"bytes that are not UTF-8 \(from byte 13\); save it as UTF-8"),
        (ENCODED["UTF-16 as Notepad writes it"][:-1], "bytes that are not UTF-16"),
        (b"\x89PNG\r\n\x1a\n", "bytes that are not UTF-8"),
        (b"", "got an empty file; was it copied whole?"),
        (codecs.BOM_UTF8, "got an empty file"),
        (b" \n", "got an empty file"),
        (TEXT[:-4].encode(), "at line 1, column 32, where the text ends; was the file cut off?"),
        (b'{"a": 1,\n "b": 2,\n}', "where a comma stands before '}'; delete the comma"),
        (b'{"a": [1, 2,]}', "where a comma stands before ']'; delete the comma"),
        (b'{\n // lens\n "a": 1}', "line 2, column 2, where a comment begins, which JSON does not"),
        (b"{'a': 1}", "where a single quote stands; JSON has double quotes"),
        (b'{"a": nan}', "line 1, column 7, from 'nan}' on; was the file cut off or edited by"),
        (b"[" * 100_000, "lists in lists too deep"),
        (b'{"a": ' + b"9" * 5000 + b"}", "a number of thousands of digits"),
    ],
)
def test_what_is_no_json_is_said_in_plain_words(
    tmp_path: Path, content: bytes, message: str
) -> None:
    with pytest.raises(SceneError, match=rf"scene file .*a.json: .*{message}") as caught:
        read(tmp_path / "a.json", content)
    assert not [word for word in PYTHON if word in str(caught.value)]


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"no such file; check the path"):
        read_json(tmp_path / "none.json", what="scene file", error=SceneError)
    with pytest.raises(SceneError, match=r"cannot be read \(Is a directory\)"):
        read_json(tmp_path, what="scene file", error=SceneError)


class Sample(BaseModel):
    number: float = 0.0
    whole: int = 0
    text: str = ""
    flag: bool = False
    items: list[int] = Field(default=[1], min_length=1)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"number": None}, "'number': expected a number, got null"),
        ({"number": "wide"}, "'number': expected a number, got 'wide'"),
        ({"whole": 1.5}, "'whole': expected a whole number, got 1.5"),
        ({"text": True}, "'text': expected text, got true"),
        ({"flag": "perhaps"}, "'flag': expected true or false, got 'perhaps'"),
        ({"items": []}, r"'items': expected a list of at least 1, got \[\]"),
        ({"items": None}, r"'items': expected a list \[ ... \], got null"),
        ([], r"'top level': expected keys with values { ... }, got \[\]"),
    ],
)
def test_wrong_values_are_said_in_the_words_of_json(data: Any, message: str) -> None:
    with pytest.raises(SceneError, match=f"x.json: {message}$"):
        parse(Sample, data, where="x.json", error=SceneError)
