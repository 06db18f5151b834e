"""Names as people give them to samples, laboratories and files: of 48 scripts, and with all punctuation of ASCII."""

import random
import string

SCRIPTS = {
    "Latin": "Prüfling",
    "Greek": "Δοκίμιο",
    "Cyrillic": "Образец",
    "Armenian": "Նմուշ",
    "Hebrew": "דגימה",
    "Arabic": "عينة",
    "Syriac": "ܛܘܦܣܐ",
    "Thaana": "ނަމޫނާ",
    "NKo": "ߊߟߊ",
    "Devanagari": "नमूना",
    "Bengali": "নমুনা",
    "Gurmukhi": "ਨਮੂਨਾ",
    "Gujarati": "નમૂનો",
    "Oriya": "ନମୁନା",
    "Tamil": "மாதிரி",
    "Telugu": "నమూనా",
    "Kannada": "ಮಾದರಿ",
    "Malayalam": "സാമ്പിൾ",
    "Sinhala": "නියැදිය",
    "Thai": "ตัวอย่าง",
    "Lao": "ຕົວຢ່າງ",
    "Tibetan": "དཔེ་ཚད",
    "Myanmar": "နမူနာ",
    "Georgian": "ნიმუში",
    "Hangul": "도료",
    "Ethiopic": "ናሙና",
    "Cherokee": "ᏣᎳᎩ",
    "Canadian": "ᐃᓄᒃᑎᑐᑦ",
    "Ogham": "᚛ᚑᚌᚐᚋ᚜",
    "Runic": "ᚠᚢᚦ",
    "Khmer": "គំរូ",
    "Mongolian": "ᠮᠣᠩᠭᠣᠯ",
    "Hiragana": "とりょう",
    "Katakana": "サンプル",
    "Han": "塗料",
    "Bopomofo": "ㄊㄨˊ",
    "Yi": "ꆈꌠ",
    "Tifinagh": "ⵜⵉⴼ",
    "Glagolitic": "ⰳⰾⰰ",
    "Coptic": "ⲕⲟⲡ",
    "Gothic": "𐌲𐌿𐍄",
    "Cuneiform": "𒀀𒁉",
    "Egyptian": "𓀀𓁐",
    "Vai": "ꕙꔤ",
    "Javanese": "ꦗꦮ",
    "Balinese": "ᬩᬮᬶ",
    "Emoji": "👩🏽‍🔬🇩🇪",
    "Math": "𝔄𝟙",
}
PUNCTUATION = string.punctuation
CONTROLS = "\x00\x01\x0b\x0c\x1b\x1f\x7f\x9b\ufffe\uffff"


def drawn_names(chance: random.Random, count: int) -> list[str]:
    """Names of some words of a script and some punctuation, in any order."""
    return [_one(chance) for _ in range(count)]


def _one(chance: random.Random) -> str:
    parts = [*chance.sample(PUNCTUATION, 6), *chance.sample(sorted(SCRIPTS.values()), 2), "a"]
    chance.shuffle(parts)
    return "".join(parts)
