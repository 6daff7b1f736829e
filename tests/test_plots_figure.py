"""Pictures fit for print: fonts, widths, colours, letters to be read, legends beside the data."""

import re

import matplotlib
import numpy as np
import pytest
from colours import CONES, nearest
from matplotlib.axis import Axis
from matplotlib.text import Text
from small_warehouse import ROWS

from qdenv.cli.main import run
from qdenv.study.groups import CURVES, Group
from qdenv.study.recordings import Maps
from qdenv.study.table import Peak, Row
from qdenv.types import InputError, Measure
from qdenv.view import COLUMN, PAGE, parse_width
from qdenv.view.guidance import draw_guidance
from qdenv.view.runs import draw_archives, draw_progress
from qdenv.view.studies import draw_comparison, draw_over_agents, draw_peaks
from qdenv.view.style import PALETTE, WARNING, format_name, new_figure, save_figure, styled
from qdenv.view.traffic import LINE, Scene, draw_panel, draw_traffic

RNG = np.random.default_rng(0)
NAMES = ("warehouse_human", "warehouse_even_nca_a5", "my_plan")


def rows(counts=(50, 100, 200)):
    """Rows of three layouts, whose throughput fills the panel."""
    return [
        Row(name, 33, 36, count, 10, place + count / 30, 0.2, 0.8, 0.5, 0.95,
            place + count / 30, 0.1, 0.2)
        for place, name in enumerate(NAMES) for count in counts
    ]  # fmt: skip


def peaks():
    return [Peak(name, 33, 36, 200, 6.5 + place, 1.0, True) for place, name in enumerate(NAMES)]


def groups():
    steps = np.arange(1, 6) * 50
    return [
        Group(label, (None, None), steps, {name: RNG.random((2, 5)).cumsum(1) for name in CURVES})
        for label in ("CMA-MAE", "MAP-Elites", "random search")
    ]


def scene():
    free = np.ones((12, 16), bool)
    maps = Maps(*(RNG.random((12, 16)) for _ in range(4)), 10.0, RNG.random((5, 12, 16)))
    over_time = np.array([np.arange(1, 41) * 25.0, RNG.random(40) + 5, np.full(40, 0.3)])
    worst = [{"row": 2, "column": place} for place in range(3)]
    return Scene(free, maps, worst, over_time, [300], 5)


@pytest.fixture
def every(monkeypatch):
    """Draw each picture at a width."""
    monkeypatch.setattr(Group, "title", property(lambda group: f"{group.label} (seeds 0, 1)"))
    axes = (Measure("connected shelf components", 0, 4, 4), Measure("entropy", 0, 1, 3))
    shown = [(f"MAP-Elites (seed {seed})", RNG.random(12), axes) for seed in range(4)]
    return {
        "comparison": lambda width: draw_comparison(rows(), width),
        "bars": lambda width: draw_comparison(rows((200,)), width),
        "peaks": lambda width: draw_peaks(rows(), peaks(), width),
        "throughput": lambda width: draw_over_agents(rows(), width=width),
        "success": lambda width: draw_over_agents(rows(), True, width),
        "progress": lambda width: draw_progress(groups(), "throughput", width),
        "archives": lambda width: draw_archives(shown, "throughput", width),
        "traffic": lambda width: draw_traffic(
            scene(), "plan, 10 agents: flows, more would fit", width
        ),
        "time": lambda width: draw_panel(scene(), "time", width),
        "guidance": lambda width: draw_guidance(
            scene().free, 1 + RNG.random((5, 12, 16)), RNG.random((5, 12, 16)), "plan"
        ),
    }


KINDS = (
    "comparison", "bars", "peaks", "throughput", "success", "progress", "archives", "traffic",
    "time", "guidance",
)  # fmt: skip


def legends(figure):
    inside = [axes.get_legend() for axes in figure.axes]
    return [*figure.legends, *filter(None, inside)]


def points(axes):
    """List the points of all lines of some axes, in pixels."""
    lines = [line.get_xydata() for line in axes.lines]
    lines += [np.stack([patch.get_data().edges[1:], patch.get_data().values], axis=1)
              for patch in axes.patches if hasattr(patch, "get_data")]  # fmt: skip
    shown = [axes.transData.transform(line) for line in lines if len(line)]
    return np.concatenate(shown) if shown else np.zeros((0, 2))


@pytest.mark.parametrize("width", [COLUMN, PAGE])
@pytest.mark.parametrize("kind", KINDS)
def test_letters_can_be_read_inside_the_picture_and_legends_cover_no_data(every, kind, width):
    figure = every[kind](width)
    figure.draw_without_rendering()
    texts = [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]
    assert min(text.get_fontsize() for text in texts) >= 6
    whole = figure.bbox.padded(3)  # pixels of 770 or 1584
    # Ticks outside of an axis' range are texts that nobody draws.
    ticks = [text for axes in figure.findobj(Axis) for text in axes.get_ticklabels()]
    for text in texts:
        box = text.get_window_extent()
        if text not in ticks:
            assert whole.x0 <= box.x0 and box.x1 <= whole.x1, text.get_text()
    if kind != "guidance":  # as wide as its floor needs
        assert figure.get_figwidth() == width
    for legend in legends(figure):
        box = legend.get_window_extent()
        for axes in figure.axes:
            for spot in points(axes):
                assert not box.contains(*spot), (kind, legend)


def test_every_picture_with_several_lines_names_them(every):
    for kind in ("comparison", "peaks", "throughput", "success", "progress", "time"):
        figure = every[kind](PAGE)
        assert len(legends(figure)) == 1, kind
    said = [text.get_text() for text in legends(every["comparison"](PAGE))[0].get_texts()]
    assert said == ["warehouse human", "warehouse even nca a5", "my plan"]


def test_pdf_holds_truetype_and_svg_holds_text(tmp_path):
    figure = draw_over_agents(rows(), width=COLUMN)
    save_figure(figure, tmp_path / "t.pdf")
    save_figure(figure, tmp_path / "t.svg")
    content = (tmp_path / "t.pdf").read_bytes()
    assert b"/FontFile2" in content and b"/Type3" not in content
    svg = (tmp_path / "t.svg").read_text()
    assert ">warehouse human<" in svg and ">robots<" in svg


def test_the_style_is_the_pictures_own(tmp_path):
    before = dict(matplotlib.rcParams)
    save_figure(draw_over_agents(rows(), True), tmp_path / "s.png")
    assert dict(matplotlib.rcParams) == before

    @styled
    def small():
        figure = new_figure(COLUMN, 2)
        figure.subplots().plot([0, 1])
        return figure

    with matplotlib.rc_context({"font.size": 30, "xtick.labelsize": 30}):
        figure = small()
        figure.draw_without_rendering()
        axes = figure.axes[0]
        assert axes.xaxis.label.get_fontsize() == 8
        figure.savefig(tmp_path / "t.png")
        assert {label.get_fontsize() for label in axes.get_xticklabels()} == {7}


def test_widths_are_read_in_words_and_inches():
    assert parse_width("column") == 3.5 and parse_width("page") == 7.2
    assert parse_width("5.25") == parse_width(5.25) == 5.25
    for wrong in ("narrow", "0", "-3", "nan", "1e9", ""):
        with pytest.raises(InputError, match=re.escape(f"width {wrong!r}: write column")):
            parse_width(wrong)


def test_names_of_layouts_are_words_and_long_paths_are_cut():
    assert format_name("warehouse_human") == "warehouse human"
    assert format_name("_") == "_"
    cut = format_name("/a/very/long/path/to/some/folder/with/plan.json")
    assert cut.startswith("...") and cut.endswith("with/plan.json") and len(cut) == 31


@pytest.mark.parametrize("cones", CONES)
def test_lines_are_told_apart_by_every_eye(cones):
    """Seven times what is just noticeable; markers differ, too."""
    assert nearest(PALETTE, cones) > 16
    assert nearest([LINE, WARNING], cones) > 90


@pytest.mark.slow
def test_commands_draw_at_the_width_that_is_asked_for(tmp_path):
    plan = tmp_path / "plan.txt"
    plan.write_text("\n".join(ROWS))
    quick = ["--planner", "pibt", "--timesteps", "40", "--seeds", "2", "--agents", "4"]
    for command, more in (("simulate", ["--no-verdict"]), ("sweep", []), ("scalability", [])):
        out = [] if command == "simulate" else ["--out", str(tmp_path / f"{command}.csv")]
        picture = tmp_path / f"{command}.svg"
        line = [command, str(plan), *quick, *more, *out, "--plot", str(picture)]
        assert run([*line, "--width", "column"]) == 0
        assert 'width="252pt"' in picture.read_text(), command  # 3.5 inches
