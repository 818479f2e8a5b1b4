"""Shorter STEP text: the same entities with other numbers, and nothing lost."""

from __future__ import annotations

from tacbench_cad.formats.step_text import compact

HEAD = b"ISO-10303-21;\nHEADER;\nFILE_NAME('a  b');\nENDSEC;\nDATA;\n"
TAIL = b"ENDSEC;\nEND-ISO-10303-21;\n"


def compacted(*lines: bytes) -> list[bytes]:
    text = compact(HEAD + b"".join(line + b"\n" for line in lines) + TAIL)
    assert text.startswith(HEAD)
    assert text.endswith(TAIL)
    return text[len(HEAD) : -len(TAIL)].splitlines()


def test_equal_points_are_written_once_and_come_first() -> None:
    lines = compacted(
        b"#1 = VERTEX_POINT('',#2);",
        b"#2 = CARTESIAN_POINT('',(0.,1.5,2.));",
        b"#3 = VERTEX_POINT('',#4);",
        b"#4 = CARTESIAN_POINT('',(0.,1.5,2.));",
        b"#5 = CARTESIAN_POINT('',(0.,1.5));",
    )
    assert lines == [
        b"#1=CARTESIAN_POINT('',(0.,1.5,2.));",
        b"#2=CARTESIAN_POINT('',(0.,1.5));",
        b"#3=VERTEX_POINT('',#1);",
        b"#4=VERTEX_POINT('',#1);",
    ]


def test_lines_and_contexts_of_curves_on_surfaces_are_shared() -> None:
    context = (
        b"( GEOMETRIC_REPRESENTATION_CONTEXT(2) \nPARAMETRIC_REPRESENTATION_CONTEXT()\n"
        b" REPRESENTATION_CONTEXT('2D SPACE','') );"
    )
    one = [
        b"PCURVE('',#9,#%d);",
        b"DEFINITIONAL_REPRESENTATION('',(#%d),#%d);",
        b"LINE('',#%d,#%d);",
        b"CARTESIAN_POINT('',(0.,1.));",
        b"VECTOR('',#%d,1.);",
        b"DIRECTION('',(1.,0.));",
        context,
    ]
    numbers = [(2,), (3, 7), (4, 5), (), (6,), (), ()]
    lines = [
        b"#%d = " % (base + k) + (text % tuple(base + n - 1 for n in refers) if refers else text)
        for base in (20, 40)
        for k, (text, refers) in enumerate(zip(one, numbers, strict=True))
    ]
    result = compacted(*lines)
    assert len(result) == 8
    assert sum(line.split(b"=")[1].startswith(b"PCURVE('',#9,#") for line in result) == 2
    assert len({line.split(b"=", 1)[1] for line in result}) == 7


def test_strings_keep_their_spaces_numbers_and_semicolons() -> None:
    lines = compacted(
        b"#7 = PRODUCT('plate #7; it''s  wide','', \n  'x',(#8));", b"#8 = PRODUCT_CONTEXT('',#7,'mechanical');"
    )
    assert lines == [
        b"#1=PRODUCT('plate #7; it''s  wide','','x',(#2));",
        b"#2=PRODUCT_CONTEXT('',#1,'mechanical');",
    ]
