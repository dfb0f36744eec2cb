import csv
import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.base.tables import Table, read_table
from calibration.base.tables import table as table_module
from calibration.base.tables.table import Row, parse_delimiter, parse_table, recognise_delimiter
from tests.base.tables.conftest import ATOM


def test_atoms_table(atom_file: Path) -> None:
    table = read_table(atom_file)
    assert table.name == str(atom_file)
    assert table.header == ("Collection #", "RMS (pix)", "X err (pix)", "Y err (pix)", "Trans (mm)", "Rot (deg)")
    assert table.rows[0] == Row(2, ("000", "0.5", "0.3", "0.4", "1.5", "0.02"))
    assert table.rows[-1].line == 5
    assert table.column("Y err (pix)") == 3


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("last", [True, False])
def test_line_ends(line_end: str, last: bool) -> None:
    text = line_end.join(["a,b", "1,2", "3,4"]) + line_end * last
    assert parse_table(text, "t").rows == (Row(2, ("1", "2")), Row(3, ("3", "4")))


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le+bom", "utf-16-be+bom", "utf-32", "latin-1"]
)
def test_encodings_are_recognised(tmp_path: Path, encoding: str) -> None:
    codec = encoding.removesuffix("+bom")
    mark = "\ufeff" if encoding.endswith("+bom") else ""
    (tmp_path / "t.csv").write_bytes((mark + "Größe,µ\n1,ß\n").encode(codec))
    table = read_table(tmp_path / "t.csv")
    assert table.header == ("Größe", "µ")
    assert table.rows == (Row(2, ("1", "ß")),)


def test_an_encoding_can_be_given(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes("a,b\n1,é\n".encode("utf-16-le"))
    assert read_table(path, encoding="utf-16-le").rows[0].cells == ("1", "é")
    with pytest.raises(
        InputError, match=r"t\.csv:1: this is no CSV file: it holds .*; if it is text, give its encoding"
    ):
        read_table(path)
    with pytest.raises(InputError, match=r"t\.csv: the file is not in the encoding ascii"):
        read_table(path, encoding="ascii")
    for name in ("klingon", "rot13", "a\0b"):
        with pytest.raises(InputError, match="encoding"):
            read_table(path, encoding=name)


@pytest.mark.parametrize(
    ("text", "delimiter"),
    [
        ("a,b\n1,2\n", ","),
        ("a;b\n1,5;2,5\n", ";"),
        ("a\tb c, d\n1\t2\n", "\t"),
        ("a|b\n1|2\n", "|"),
        ("RMS, pixels;X\n1;2\n3;4\n", ";"),
        ("name,note\nx,one; two\ny,three; four\n", ","),
        ('"a;b;c;d",x\n"1;2;3;4",2\n', ","),
        ("only\n1\n", ","),
        ("a;b;c\n1;2", ";"),
        ("", ","),
    ],
)
def test_delimiters_are_recognised(text: str, delimiter: str) -> None:
    assert recognise_delimiter(text) == delimiter


def test_a_delimiter_can_be_given() -> None:
    assert parse_table("a,b;c\n1,2;3\n", "t", ";").header == ("a,b", "c")


@pytest.mark.parametrize(
    ("name", "delimiter"),
    [
        ("comma", ","),
        ("Semicolon", ";"),
        ("tab", "\t"),
        ("\\t", "\t"),
        ("\t", "\t"),
        ("pipe", "|"),
        (":", ":"),
        (";", ";"),
    ],
)
def test_names_of_delimiters(name: str, delimiter: str) -> None:
    assert parse_delimiter(name) == delimiter


@pytest.mark.parametrize("name", ["", "ab", "x", "1", '"', "\n", " ", ".", "-"])
def test_what_is_no_delimiter(name: str) -> None:
    with pytest.raises(InputError, match="delimiter"):
        parse_delimiter(name)


def test_quotes_white_space_and_blank_lines() -> None:
    table = parse_table('\n a , "b, c"\n\n"1\n2",  "say ""x"""\n   \n3,4\n\n', "t")
    assert table.header == ("a", "b, c")
    assert table.rows == (Row(4, ("1\n2", 'say "x"')), Row(7, ("3", "4")))


def test_empty_cells_stay() -> None:
    assert parse_table("a,b,c\n,,\n1,,\n", "t").rows == (Row(2, ("", "", "")), Row(3, ("1", "", "")))


def test_empty_cells_beyond_the_header_are_dropped() -> None:
    assert parse_table("a,b\n1,2,\n3,4,,\n", "t").rows == (Row(2, ("1", "2")), Row(3, ("3", "4")))


def test_a_header_alone_is_a_table() -> None:
    assert parse_table("a,b\n", "t") == Table("t", ("a", "b"), ())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "t: there is nothing in the file"),
        ("\n\n \n", "t: there is nothing in the file"),
        ("a,b\n1\n2,3\n", "t:2: the row has 1 of 2 cells"),
        ("a,b\n1,2,3\n", "t:2: the row has 3 of 2 cells"),
        ("a,b,c\n1,2,3\n4,5", "t:3: the file ends in the middle of a row, after 2 of 3 cells"),
        ("a,b,c\n1,2,3\n4,5\n", "t:3: the row has 2 of 3 cells"),
        ('a,b\n1,"2\n3,4\n', "t:2: the file ends in the middle of a row: a quote is never closed"),
        ('a,b\n1,"2"x\n', "t:2: the row is not well-formed CSV"),
        ("a,b\n1,\x00\n", "t:2: this is no CSV file"),
        ("\x89PNG\r\n\x1a\n", "t:2: this is no CSV file"),
        ("a,b\n1," + "x" * 200_000 + "\n", "t:2: the row is not well-formed CSV: field larger than"),
    ],
)
def test_what_is_no_table(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_table(text, "t")
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_columns(atom: Table) -> None:
    with pytest.raises(InputError, match=r"results\.csv: there is no column 'RMS': did you mean|; the columns are"):
        atom.column("RMS")
    with pytest.raises(InputError, match=r"no column 'RMS \(px\)': did you mean 'RMS \(pix\)'\?"):
        atom.column("RMS (px)")
    with pytest.raises(InputError, match="'a' occurs more than once in the header, as 1 and 3"):
        parse_table("a,b,a\n1,2,3\n", "t").column("a")


def test_files_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"none\.csv: a CSV file was expected, but it cannot be read: No such file"):
        read_table(tmp_path / "none.csv")
    with pytest.raises(InputError, match="this is no regular file, a CSV file was expected"):
        read_table(tmp_path)
    with pytest.raises(InputError, match="File name too long"):
        read_table(tmp_path / ("x" * 300))
    with pytest.raises(InputError, match=r"null (byte|character)"):
        read_table("a\0b")
    (tmp_path / "file").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="Not a directory"):
        read_table(tmp_path / "file" / "x.csv")
    with pytest.raises(InputError, match="no regular file"):
        read_table("/dev/zero")
    monkeypatch.setattr(table_module, "MAX_BYTES", 7)
    with pytest.raises(InputError, match="found 8 bytes, a CSV file of at most 7"):
        read_table(tmp_path / "file")


CELLS = st.text(st.characters(blacklist_categories=["Cs"]), max_size=8).map(
    lambda text: "".join(c for c in text if (ord(c) >= 32 and ord(c) != 127) or c in "\n\t").strip().strip("\ufeff")
)


@given(data=st.data(), delimiter=st.sampled_from([",", ";", "\t", "|"]), line_end=st.sampled_from(["\n", "\r\n"]))
def test_what_the_csv_module_writes_reads_back(data: st.DataObject, delimiter: str, line_end: str) -> None:
    width = data.draw(st.integers(1, 4))
    row = st.lists(CELLS, min_size=width, max_size=width).map(tuple)
    header, *rows = data.draw(st.lists(row.filter(any), min_size=1, max_size=5))
    stream = io.StringIO(newline="")
    csv.writer(stream, delimiter=delimiter, lineterminator=line_end).writerows([header, *rows])
    table = parse_table(stream.getvalue(), "t", delimiter)
    assert table.header == header
    assert [row.cells for row in table.rows] == rows


@given(st.binary(max_size=200))
def test_any_bytes_are_a_table_or_bad_input(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("x") / "t.csv"
    path.write_bytes(data)
    try:
        table = read_table(path)
    except InputError:
        return
    assert all(len(row.cells) == len(table.header) for row in table.rows)


@given(st.integers(0, len(ATOM)))
def test_a_truncated_table_never_has_half_a_row(length: int) -> None:
    try:
        table = parse_table(ATOM[:length], "t")
    except InputError:
        return
    assert all(len(row.cells) == len(table.header) for row in table.rows)
