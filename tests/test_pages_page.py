"""A page holds everything itself: arrays come back whole, text stays text, no network is asked."""

import base64
import gzip

import numpy as np
import pytest

from qdenv.types import InputError
from qdenv.view import page as pages
from qdenv.view.page import make_page, pack

NASTY = '</script><script>document.title="taken"</script>'


def test_packed_arrays_are_gzip_in_base64():
    array = np.arange(1000, dtype=np.int16)
    raw = gzip.decompress(base64.b64decode(pack(array)))
    np.testing.assert_array_equal(np.frombuffer(raw, np.int16), array)


@pytest.mark.slow
def test_a_browser_reads_back_what_python_packed(tmp_path, opened):
    array = np.random.default_rng(0).integers(0, 2**16, 50_000).astype("<u2")
    facts = {"nasty": NASTY, "number": 0.1}
    page = make_page("page", "A page", facts=facts, packed={"numbers": array})
    with opened(page.save(tmp_path / "page.html")) as shown:
        assert shown.title() == "A page"
        assert shown.evaluate("facts") == facts
        script = "unpack('numbers').then(found => [...new Uint16Array(found)])"
        assert shown.evaluate(script) == array.tolist()


def test_a_notebook_frame_holds_the_whole_page():
    page = make_page("page", "A <page>", facts={"nasty": NASTY})
    frame = page._repr_html_()
    assert frame.startswith("<iframe srcdoc=") and NASTY not in frame
    assert "<title>A &lt;page&gt;</title>" in page.html


def test_a_missing_package_is_named_with_what_installs_it(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r'pages need jinja2: pip install "qdenv\[viz\]"'):
        pages.make_page("page", "A page")
