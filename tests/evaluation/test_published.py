import pytest

from touchnet.evaluation.published import TITLE, read_published

HEADER = "source,method,category,measure,value\n"


def written(tmp_path, text):
    path = tmp_path / "published.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_measures_become_columns_and_values_stay_as_they_are(tmp_path):
    text = HEADER + '"A, 2022",FI,bottle,CD,1.50\n"A, 2022",FI,bottle,F 1%,0.3\n"A, 2022",FA,mean,F 1%,0.20\n'
    table = read_published(written(tmp_path, text))
    assert table.title == TITLE
    assert table.header == ["source", "method", "category", "CD", "F 1%"]
    assert table.lines == [["A, 2022", "FI", "bottle", "1.50", "0.3"], ["A, 2022", "FA", "mean", "n/a", "0.20"]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "line 1 should be source,method,category,measure,value, got nothing"),
        ("method,value\nFI,1\n", "line 1 should be source,.* got method,value"),
        (HEADER, "no figure in this file"),
        (HEADER + "A,FI,bottle,CD\n", "line 2 should have 5 fields"),
        (HEADER + "A,FI,bottle,CD,1,2\n", "line 2 should have 5 fields"),
        (HEADER + "A,FI,bottle,CD,small\n", "line 2: value should be a number, got 'small'"),
        (HEADER + "A,FI,bottle,CD,1\nA,FI,bottle,CD,2\n", "line 3: CD of FI, bottle is given twice"),
    ],
)
def test_a_file_of_another_kind_is_refused_in_words(tmp_path, text, words):
    with pytest.raises(ValueError, match=words):
        read_published(written(tmp_path, text))
