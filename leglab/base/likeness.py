"""Similarity of names, by their words in any order or by their numbers."""

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Sequence
from difflib import SequenceMatcher
from functools import lru_cache

import numpy as np

# Minimum length of a word that may match part of another, because shorter words match by chance.
_SHORT = 3
# Weight of a common word such as joint or motor; a distinctive word has the weight 1.
_PLAIN_WEIGHT = 0.1
# Penalty per word that a candidate lacks. It only breaks ties: other score differences are larger.
_FURTHER = 0.01


def words_of(name: str, known: Collection[str] = ()) -> list[str]:
    """Returns words and numbers of a name in lower case: knee, q, meas, 0 for `KneeQ_meas[0]`.

    A word that is composed of two `known` words is split, for instance `kneepos`.
    """
    spaced = re.sub(r"(?<=[^\W\d_A-Z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    found: list[str] = []
    for word in (word.lower() for word in re.findall(r"[^\W\d_]+|\d+", spaced)):
        cuts = range(1, len(word)) if word not in known else ()
        halves = ([word[:cut], word[cut:]] for cut in cuts)
        pairs = (h for h in halves if set(h) <= set(known) and max(map(len, h)) >= _SHORT)
        found += next(pairs, [word])
    return found


def likeness_of_words(
    words: Sequence[str], names: Sequence[Sequence[str]], plain: Collection[str]
) -> np.ndarray:
    """Scores the similarity of a name's words to the words of each candidate, 0 to 1, (names,).

    Args:
        words: Words of the name to be matched.
        names: Words of each candidate name.
        plain: Common words, with a low weight. A candidate that shares only a number scores 0.
    """
    count = Counter(word for name in names for word in name)
    known = {word for word in words if word in count and word not in plain}
    found = np.zeros(len(names))
    for i, name in enumerate(names):
        weights = [(_PLAIN_WEIGHT if w in plain else 1.0) / count[w] for w in name]
        ratios = [max((_ratio(word, w) for word in words), default=0.0) for w in name]
        if any(r for r, w in zip(ratios, name, strict=True) if not w.isdigit()):
            # Words that occur only in other candidates reduce the score of this candidate.
            foreign = len(known - set(name)) / max(len(known), 1)
            further = _FURTHER * sum(word not in name for word in words)
            found[i] = max(np.dot(weights, ratios) / sum(weights) - 0.5 * foreign - further, 0.0)
    return found


@lru_cache(maxsize=100_000)
def _ratio(one: str, other: str) -> float:
    """Returns the similarity of two words, 0 to 1: equal, one a prefix, or similar spelling."""
    if one == other or one.isdigit() or other.isdigit():
        return float(one == other)
    if one.startswith(other) or other.startswith(one):
        return 0.8
    ratio = SequenceMatcher(None, one, other).ratio()
    return ratio if ratio > 0.75 and min(len(one), len(other)) >= _SHORT else 0.0


def numbered(names: Iterable[str]) -> dict[str, tuple[int, tuple[int, ...]]]:
    """Returns by name its number, and the numbers of all names that differ only in the number."""
    peers: dict[str, dict[int, str]] = defaultdict(dict)
    for name in names:
        for match in re.finditer(r"\d+", name):
            peers[f"{name[: match.start()]}#{name[match.end() :]}"][int(match[0])] = name
    found: dict[str, tuple[int, tuple[int, ...]]] = {}
    for group in sorted(peers.values(), key=len):  # the largest group comes last and overwrites
        found |= {name: (number, tuple(sorted(group))) for number, name in group.items()}
    return found


def likeness_of_numbers(
    number: int, peers: Sequence[int], names: Sequence[Sequence[str]]
) -> np.ndarray:
    """Scores candidate names for a number: equal number, or position in sorted order, (names,).

    Args:
        number: Number in a name, from `numbered`.
        peers: Numbers of the group from `numbered`; as many of them as `names` raise the score.
        names: Words of each candidate name, (names,).
    """
    found = np.zeros(len(names))
    own = [next((int(w) for w in words[::-1] if w.isdigit()), -1) for words in names]
    if peers and len(set(own)) == len(own) and set(peers) <= set(own):
        found[own.index(number)] = 0.9
    elif peers and peers[0] in (0, 1) and number - peers[0] < len(names):
        found[number - peers[0]] = 0.8 if len(peers) == len(names) else 0.5
    return found
