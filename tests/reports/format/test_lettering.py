"""Letters in drawings on paper, against matplotlib's reader of fonts."""

from matplotlib.ft2font import FT2Font, LoadFlags

from reports.format.lettering import FONTS, printable, text_width

FONT = FT2Font(FONTS / "DejaVuSans.ttf")


def test_each_letter_of_the_font_is_as_wide_as_the_font_says() -> None:
    letters = FONT.get_charmap()
    assert len(letters) > 5000
    for code in letters:
        advance = FONT.load_char(code, LoadFlags.NO_SCALE).horiAdvance / FONT.units_per_EM
        assert text_width(chr(code), 10.0) == 10.0 * advance


def test_letters_that_the_font_lacks_are_replaced_and_no_others() -> None:
    there = FONT.get_charmap()
    for code in range(0x21, 0x3000):
        letter = chr(code)
        if letter.isprintable() and not letter.isspace():
            assert printable(letter) == (letter if code in there else "\ufffd"), hex(code)
