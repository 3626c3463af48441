import json
import re
from pathlib import Path

import pytest
from objects import demo

from lying_world import in_lying_world
from pcore.errors import InputError
from pcore.studio.recording import Recording, record
from pcore.studio.viewer_page import viewer_page


@pytest.fixture(scope="module")
def recording() -> Recording:
    return record(demo(), [demo().pose()])


def test_it_needs_nothing_else(recording: Recording) -> None:
    text = viewer_page(recording, title="toy").content.decode()
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!data:)", text)
    assert "default-src 'none'" in text
    assert not re.search(r"https?://", text)


def test_a_title_is_text(recording: Recording) -> None:
    title = "<script>alert(1)</script> @DATA@ \\g<0>"
    text = viewer_page(recording, title=title).content.decode()
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt; @DATA@ \\g&lt;0&gt;" in text


def test_it_is_no_larger_than_asked(recording: Recording) -> None:
    whole = viewer_page(recording, title="toy")
    limit = len(whole.content) // 2
    small = viewer_page(recording, title="toy", limit=limit)
    assert len(small.content) <= limit
    assert small.notes
    assert not whole.notes


def test_a_limit_without_room_is_refused(recording: Recording) -> None:
    with pytest.raises(InputError, match="expected a limit"):
        viewer_page(recording, title="toy", limit=1000)


def test_an_object_before_a_background_is_seen_upright_and_from_near(tmp_path: Path) -> None:
    asset = in_lying_world(tmp_path / "toy")
    text = viewer_page(record(asset, [asset.pose()]), title="toy").content.decode()
    found = re.search(r'id="head">(.*?)</script>', text)
    assert found is not None
    head = json.loads(found.group(1))
    assert head["axes"][2][1] < -0.95
    assert head["count"] == 205
    assert max(map(abs, head["center"])) < 0.25
    assert head["distance"] < 1
