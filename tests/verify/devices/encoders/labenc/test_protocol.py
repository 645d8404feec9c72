import pytest
from hypothesis import given
from hypothesis import strategies as st

from verify.devices.encoders.labenc import protocol as lines
from verify.devices.ports import CHECKSUMS, LineBuffer

SHEET = """$H,LABENC,1.0,IUST6R,6,deg,1000000,100,0123ABCD*4B
$N,1,98304,1,0*48
$J,1041,52345678,-7.4200,38.2100,77.7400,7.0800,61.7200,-9.7500,0*62
$C,1041,52345678,-2026,10434,21228,1933,16853,-2662,0*69
$M,52400000,1,1*62
$W,low supply 22.8 V*7C
$Q*51
$S,1*4E
$S,0*4F
$R,100*4F
$D,counts*78
$T,17*7E
$T,17,52345678,52345702*72
$G,1,12.50*5E
$A,S,1*23
$E,S,2,bad rate*4D
$E,?,1,checksum*6A
$H,LABENC,1.0,PANBASE,2,deg,1000000,50,P0000001*2B
$J,88,61000000,12.5000,-12.5000,0*7C
$A,G,1,12.50*33
$E,G,3,axis 1 limit*5A""".splitlines()
SAMPLE = SHEET[2].encode()


@pytest.mark.parametrize("line", SHEET)
def test_every_line_of_the_sheet_is_framed_and_read(line: str) -> None:
    assert lines.frame_line(line[1:].rpartition("*")[0]) == line.encode() + b"\n"
    assert not isinstance(lines.parse_line(line.encode()), str)


def test_lines_are_parsed_to_their_fields() -> None:
    hello, axis, sample, counts = (lines.parse_line(line.encode()) for line in SHEET[:4])
    assert hello == lines.LabencGreeting(1, 0, 6, "deg", 1_000_000)
    assert axis == lines.LabencAxis(1, 98304, 1, 0)
    assert isinstance(counts, lines.LabencSample)
    assert (sample.sequence, sample.tick) == (1041, 52345678)
    degrees = lines.sample_values(sample, 6, decimal=True, exact=True)
    assert degrees == ((-7.42, 38.21, 77.74, 7.08, 61.72, -9.75), 0)
    assert lines.sample_values(counts, 6, decimal=False, exact=True) == (
        (-2026, 10434, 21228, 1933, 16853, -2662), 0,
    )  # fmt: skip
    assert lines.sample_values(sample, 5, decimal=True, exact=True) is None
    assert lines.sample_values(sample, 6, decimal=False, exact=True) is None


def test_published_check_values_of_the_checksums() -> None:
    assert CHECKSUMS["crc16"][1](b"123456789") == 0x29B1  # CRC-16/CCITT-FALSE
    assert CHECKSUMS["crc8"][1](b"123456789") == 0xF4  # CRC-8
    assert CHECKSUMS["sum8"][1](b"123456789") == sum(b"123456789") % 256
    body = b"GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M,55.2,M,,"
    assert CHECKSUMS["xor"][1](body) == 0x76  # the usual NMEA 0183 example


@given(st.integers(0, len(SAMPLE) - 1), st.integers(0, 255))
def test_one_wrong_byte_never_passes(at: int, byte: int) -> None:
    changed = SAMPLE[:at] + bytes([byte]) + SAMPLE[at + 1 :]
    if changed != SAMPLE:
        assert isinstance(lines.parse_line(changed), str)


@given(st.lists(st.binary(max_size=40)))
def test_lines_do_not_depend_on_how_the_bytes_come(pieces: list[bytes]) -> None:
    whole, cut = LineBuffer(), LineBuffer()
    at_once = whole.feed(b"".join(pieces))
    assert [line for piece in pieces for line in cut.feed(piece)] == at_once


def test_noise_without_an_end_does_not_fill_the_memory() -> None:
    buffer = LineBuffer()
    for _ in range(100):
        assert buffer.feed(b"x" * 1000) == []
    assert sum(map(len, buffer.feed(b"\n"))) < 5000
    assert buffer.feed(SAMPLE + b"\r\n") == [SAMPLE]
