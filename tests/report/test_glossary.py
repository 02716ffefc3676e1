"""Words of the pages: linked once to what they mean, at the foot of the same page."""

import re

from leglab.report.diagnosis.page import write_page
from leglab.report.page.glossary import MEANINGS, Glossary
from leglab.report.page.shell import Table, render
from tests.helpers.made_up_diagnosis import diagnosis
from tests.helpers.pages import ROOT


def test_the_first_use_of_a_word_links_to_its_meaning_on_the_page():
    table = Table(caption="Noise levels of the frozen twin", head=("x",), rows=[["frozen twin"]])
    found = render(
        "tables.html",
        kind="bench",
        title="t",
        headline="h",
        sections=[{"name": "s", "title": "s", "text": "", "tables": [table], "folds": []}],
        links=[("s", "s")],
    )
    links = re.findall(r'<a class="term" href="#([^"]*)" title="([^"]*)">([^<]*)</a>', found)
    assert [text for *_, text in links] == ["Noise levels", "frozen twin"]
    for name, meaning, _ in links:
        (shown,) = re.findall(f'<div id="{name}" tabindex="-1"><dt>.*?</dt><dd>(.*?)</dd>', found)
        assert shown == meaning
    assert found.count('<th scope="row">frozen twin</th>') == 1


def test_text_is_escaped_and_longer_words_go_before_their_parts():
    glossary = Glossary()
    told = str(glossary("<b> & 90 % undone, undone, sufferings, held-out\x00"))
    assert told.startswith("&lt;b&gt; &amp; <a ")
    assert list(glossary.used) == ["90 % undone", "undone", "held out"]
    assert told.endswith(">held-out</a>\ufffd")
    assert glossary("Undone") == "Undone"


def test_no_meaning_needs_a_word_that_has_none(tmp_path):
    words = re.compile(r"frozen twin|own peak|noise level|recalibrated|confusion set")
    for meaning in MEANINGS.values():
        assert all(word in MEANINGS for word in words.findall(meaning))
    text = write_page(diagnosis("confusion_set"), tmp_path, model="m").read_text()
    body = text[text.index("<main>") :]
    for word in words.findall(re.sub("<[^>]*>", " ", body)):
        assert MEANINGS[word] in body.replace("&#39;", "'")


def test_every_word_stands_in_the_glossary_of_the_documentation():
    text = (ROOT / "docs/reference/glossary.md").read_text()
    words = " , ".join(row.split(" | ")[0] for row in text.splitlines() if row.startswith("| "))
    assert [term for term in MEANINGS if term not in words] == []
