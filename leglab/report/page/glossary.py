"""Glossary of terms that newcomers may not know, and links to it from the texts of the pages."""

import re

from markupsafe import Markup, escape

from leglab.report.page.wording import printable

# Meanings by term. Terms are recognised in texts regardless of case, and with a plural s.
MEANINGS = {
    "90 % undone": "Time from the change of the machine until the error, stride by stride, stays "
    "below a level at which nine tenths of the damage are gone. Never: not within the run.",
    "chi-square": "Sum of squared differences in units of the noise: how far two explanations lie "
    "apart. Above some 10 they can be told apart.",
    "confidence": "Probability that the name is right, between 0 and 100 %.",
    "confusion set": "Effects that explain the recordings equally well. All of them are listed, "
    "and an experiment is proposed that would tell them apart.",
    "damage": "What a change of the machine costs: the error that it causes less the error before "
    "it. The error that it causes is that of the frozen twin, or the run's own peak.",
    "feed-forward": "Part of a command that follows from the reference and a model of the machine, "
    "without waiting for an error.",
    "free run": "Simulation of the output from the inputs alone, after measured first samples. Its "
    "fit is 100 % without an error, and 0 % if it errs as much as the output's mean.",
    "frozen twin": "The same run once more with adaptation stopped just before the change: the "
    "error that the change causes as long as nothing adapts to it.",
    "gap": "Replay error beyond what the noise of the sensors alone gives.",
    "held out": "Kept from all fits. The verdict is judged on these recordings.",
    "mrad": "Thousandth of a radian, 0.057 degrees.",
    "noise level": "Standard deviation of the noise of a sensor. An error of 1 noise level is what "
    "noise alone gives.",
    "own peak": "Largest error over one stride after the change. It stands for the error that the "
    "change causes where a controller does not adapt, and so has no frozen twin.",
    "recalibrated": "With the parameters fitted anew within the tolerance that machines of one "
    "kind have, and no effect added: what tuning alone gains.",
    "replay": "Simulation of a fraction of a second of a recording, from the measured motion and "
    "with the measured command.",
    "RMS": "Root mean square.",
    "seed": "Number that draws all that is random in a run: noise of the sensors, and where asked "
    "for, the machine, the time of the change and the phase of the motion.",
    "specimen": "One machine of its kind. Its parameters differ from the drawing within a "
    "tolerance.",
    "stride": "One period of the reference motion.",
    "tolerance": "Range, as a share, within which parameters differ between machines of one kind.",
    "undone": "Share of the damage that is gone in the last strides of the run.",
}
_ALSO = {"held-out": "held out", "kept from all fits": "held out", "nine tenths": "90 % undone"}


class Glossary:
    """Turns the first use of each term on a page into a link to its meaning.

    Attributes:
        used: Meanings by term, of the terms that were linked so far.
    """

    def __init__(self) -> None:
        self.used: dict[str, str] = {}

    def __call__(self, text: str) -> Markup:
        """Escapes a plain text, and links the first use of each term to its meaning."""
        text, parts, end = printable(text), [], 0
        for found in _TERM.finditer(text):
            term = _BY_WRITING[found[1].lower()]
            if term in self.used:
                continue
            self.used[term] = MEANINGS[term]
            link = Markup('<a class="term" href="#{}" title="{}">{}</a>').format(
                anchor(term), MEANINGS[term], found[0]
            )
            parts += [escape(text[end : found.start()]), link]
            end = found.end()
        return Markup("").join([*parts, escape(text[end:])])

    def meanings(self) -> list[tuple[str, str, str]]:
        """Returns anchor, term and meaning of all terms used in texts and meanings, sorted."""
        for meaning in (told := list(self.used.values())):
            before = len(self.used)
            self(meaning)
            told += list(self.used.values())[before:]
        return [(anchor(t), t, self.used[t]) for t in sorted(self.used, key=str.lower)]


def anchor(term: str) -> str:
    """Returns the HTML id of a term's meaning on the page."""
    return "word-" + re.sub(r"[^a-z0-9]+", "-", term.lower()).strip("-")


_BY_WRITING = {term.lower(): term for term in MEANINGS} | _ALSO
# Longer terms first, so that "90 % undone" is not matched as "undone".
_WRITINGS = "|".join(map(re.escape, sorted(_BY_WRITING, key=len, reverse=True)))
_TERM = re.compile(rf"(?<![\w-])({_WRITINGS})s?(?![\w-])", re.IGNORECASE)
