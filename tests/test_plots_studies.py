"""Pictures of studies: every number of a row stands where it belongs."""

import numpy as np
import pytest
from matplotlib.image import imread

from qdenv.study.table import Peak, Row
from qdenv.view.studies import draw_comparison, draw_peaks
from qdenv.view.style import save_figure

NAN = float("nan")


def row(layout: str, agents: int, throughput: float, rate: float = 0.5) -> Row:
    """A row of ten runs whose interval reaches 0.2 down and 0.1 up."""
    mean = np.nan_to_num(throughput) - 0.1
    return Row(layout, 9, 12, agents, 10, throughput, 0.25, rate, rate - 0.2, rate + 0.1, mean, 0.0)


def spans(container) -> np.ndarray:
    """Read the ends of error bars [n, 2] off a plot's container."""
    return np.array([segment[:, 1] for segment in container[2][0].get_segments()])


def test_lines_over_agents_carry_throughput_and_success_with_their_errors():
    rows = [row("a", 50, 2.0), row("a", 100, 3.0), row("b", 50, 1.0), row("b", 100, 4.0, 0.9)]
    above, below = draw_comparison(rows).axes
    assert [line.get_label() for line in above.containers] == ["a", "b"]
    assert above.containers[1][0].get_xydata().tolist() == [[50, 1.0], [100, 4.0]]
    np.testing.assert_allclose(spans(above.containers[0]), [[1.75, 2.25], [2.75, 3.25]])
    assert below.containers[1][0].get_ydata().tolist() == [0.5, 0.9]
    np.testing.assert_allclose(spans(below.containers[1]), [[0.3, 0.6], [0.7, 1.0]])
    assert below.get_xlabel() == "agents"


def test_one_number_of_agents_draws_bars_and_names_layouts_that_always_congest():
    rows = [row("smooth", 200, 6.5), row("jam", 200, NAN, 0.0)._replace(success_low=0.0)]
    above, below = draw_comparison(rows).axes
    assert sorted({patch.get_height() for patch in above.patches}) == [0.0, 6.5]
    assert [text.get_text() for text in above.texts] == ["6.50", "every run congested"]
    assert [label.get_text() for label in below.get_xticklabels()] == ["smooth", "jam"]
    assert above.get_title() == "200 agents, 10 runs each"


def test_bars_say_how_surely_a_layout_differs_from_the_first():
    rows = [row("one", 200, 6.1)._replace(error_of_all=0.01)]
    rows.append(row("two", 200, 6.7)._replace(error_of_all=0.02))
    figure = draw_comparison(rows)
    first, second = (text.get_text() for text in figure.axes[0].texts)
    assert first == "6.10" and second.startswith("6.70\n+10.0 %\n(+9.") and "to +10." in second
    assert "against the first layout, over all runs" in figure.get_supxlabel()


def test_axes_begin_at_zero_and_the_picture_explains_its_bars():
    figure = draw_comparison([row("a", 150, 2.0), row("a", 200, 3.0)])
    assert [axes.get_xlim()[0] for axes in figure.axes] == [0, 0]
    assert figure.axes[0].get_ylim()[0] == 0
    assert "standard error over 10 runs" in figure.get_supxlabel()


def test_success_rates_of_layouts_do_not_hide_one_another():
    rows = [row(name, agents, 2.0) for name in "abc" for agents in (50, 100)]
    below = draw_comparison(rows).axes[1]
    places = [line[0].get_xdata()[0] for line in below.containers]
    np.testing.assert_allclose(places, [48, 50, 52])


def test_peaks_are_starred_on_their_lines_and_sorted_by_size():
    rows = [row("large", 50, 2.0), row("large", 100, 5.0), row("small", 50, 1.0)]
    peaks = [
        Peak("large", 20, 20, 100, 4.9, 1.0, dropped=False),
        Peak("small", 9, 12, 50, 0.9, 1.0, dropped=True),
    ]
    left, right, twin = draw_peaks(rows, peaks).axes
    assert left.lines[0].get_xydata().tolist() == [[50, 1.9], [100, 4.9]]
    assert left.lines[1].get_xydata().tolist() == [[100, 4.9]]
    assert [patch.get_height() for patch in right.patches] == [50, 100]
    assert [text.get_text() for text in right.get_xticklabels()] == ["small\n9x12", "large\n20x20"]
    assert twin.lines[0].get_ydata().tolist() == [0.9, 4.9]


def test_names_of_files_are_text_and_no_mathematics(tmp_path):
    name = r"a$\bad$b"
    figure = draw_comparison([row(name, 50, 2.0), row("b", 50, 1.0)])
    save_figure(figure, tmp_path / "picture.svg")
    assert name in (tmp_path / "picture.svg").read_text()


@pytest.mark.parametrize("ending", ["png", "jpg"])
def test_pictures_are_written_in_the_format_of_their_ending(tmp_path, ending):
    rows = [row("a", 50, 2.0), row("a", 100, 3.0)]
    save_figure(draw_comparison(rows), tmp_path / f"c.{ending}")
    peaks = [Peak("a", 9, 12, 100, 2.9, 1.0, True)]
    save_figure(draw_peaks(rows, peaks), tmp_path / f"p.{ending}")
    assert imread(tmp_path / f"c.{ending}").shape[:2] == (1045, 1584)
    assert imread(tmp_path / f"p.{ending}").shape[:2] == (760, 1584)
    assert len(list(tmp_path.iterdir())) == 2
