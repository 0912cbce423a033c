"""What words mean to the detectors: one table of synonyms, and the names of their classes."""

from functools import cache
from pathlib import Path

from edit3r_segmenters.classical import plain

COCO = (
    "person",
    "bicycle",
    "car",
    "motorcycle",
    "airplane",
    "bus",
    "train",
    "truck",
    "boat",
    "traffic light",
    "fire hydrant",
    "stop sign",
    "parking meter",
    "bench",
    "bird",
    "cat",
    "dog",
    "horse",
    "sheep",
    "cow",
    "elephant",
    "bear",
    "zebra",
    "giraffe",
    "backpack",
    "umbrella",
    "handbag",
    "tie",
    "suitcase",
    "frisbee",
    "skis",
    "snowboard",
    "sports ball",
    "kite",
    "baseball bat",
    "baseball glove",
    "skateboard",
    "surfboard",
    "tennis racket",
    "bottle",
    "wine glass",
    "cup",
    "fork",
    "knife",
    "spoon",
    "bowl",
    "banana",
    "apple",
    "sandwich",
    "orange",
    "broccoli",
    "carrot",
    "hot dog",
    "pizza",
    "donut",
    "cake",
    "chair",
    "couch",
    "potted plant",
    "bed",
    "dining table",
    "toilet",
    "tv",
    "laptop",
    "mouse",
    "remote",
    "keyboard",
    "cell phone",
    "microwave",
    "oven",
    "toaster",
    "sink",
    "refrigerator",
    "book",
    "clock",
    "vase",
    "scissors",
    "teddy bear",
    "hair drier",
    "toothbrush",
)
"""The 80 things of COCO, in order."""

# What a person says, and the name that a detector has for it. The first name that a detector knows
# is taken; names that are joined by "/" are one group to it.
SYNONYMS = {
    "animal toy": "teddy bear",
    "automobile": "car/sports car/minivan",
    "ball": "sports ball",
    "bag": "handbag/backpack/suitcase",
    "basket": "shopping basket/hamper",
    "bell tower": "bell cote/church/beacon/water tower",
    "bike": "motorcycle/bicycle",
    "bin": "ashcan",
    "bird": "bird/hen/cock/robin/jay/magpie/goose/drake/macaw/ostrich",
    "blanket": "quilt",
    "boat": "boat/speedboat/canoe/gondola/fireboat/lifeboat",
    "box": "carton/crate/chest/tub",
    "building": "palace/church/barn/library/castle/monastery/mosque/boathouse/greenhouse",
    "cabinet": "china cabinet/medicine chest/file",
    "candle": "candle",
    "carpet": "prayer rug",
    "car": "car/sports car/minivan/convertible/cab/beach wagon/limousine",
    "cat": "cat/tabby/tiger cat/persian cat/siamese cat/egyptian cat",
    "church": "church",
    "coat": "trench coat/lab coat/fur coat",
    "computer": "laptop/desktop computer",
    "coffee cup": "cup",
    "couch": "couch",
    "cupboard": "wardrobe/china cabinet",
    "curtain": "shower curtain/theater curtain",
    "cushion": "pillow",
    "cycle": "bicycle",
    "desk": "dining table/desk",
    "dinosaur": "triceratops",
    "dog": "dog",
    "doughnut": "donut",
    "drawers": "chiffonier",
    "dress": "gown",
    "dustbin": "ashcan",
    "duvet": "quilt",
    "fence": "picket fence/chainlink fence/worm fence",
    "fern": "potted plant",
    "fish": "goldfish/tench/coho/rock beauty/anemone fish",
    "flower": "daisy/yellow lady's slipper",
    "fox": "red fox/kit fox/arctic fox/grey fox",
    "fridge": "refrigerator",
    "football": "sports ball",
    "glass": "wine glass/goblet/cup",
    "goblet": "wine glass",
    "guy": "person",
    "hat": "cowboy hat/sombrero/bonnet/bearskin",
    "helmet": "crash helmet/football helmet",
    "house": "barn/boathouse/palace/mobile home/greenhouse",
    "hydrant": "fire hydrant",
    "jet": "airplane",
    "jug": "water jug/whiskey jug/pitcher",
    "kettle": "teapot/caldron/coffeepot",
    "kid": "person",
    "lady": "person",
    "lamp": "table lamp/spotlight/lampshade",
    "laptop": "laptop",
    "lighthouse": "beacon",
    "lorry": "truck",
    "magazine": "comic book/book jacket/menu/book",
    "man": "person",
    "mask": "mask",
    "mirror": "car mirror/medicine chest",
    "mobile": "cell phone",
    "monitor": "tv/monitor/screen",
    "moped": "motorcycle/moped",
    "motorbike": "motorcycle",
    "mug": "cup/coffee mug",
    "notebook": "laptop",
    "opera house": "boathouse/planetarium/palace/dome",
    "people": "person",
    "phone": "cell phone",
    "picture frame": "window screen/entertainment center",
    "plane": "airplane",
    "plant": "potted plant",
    "planter": "pot",
    "plate": "plate/plate rack",
    "pony": "horse",
    "purse": "handbag/purse",
    "pot": "pot/potted plant",
    "quilt": "quilt",
    "rose": "daisy",
    "scooter": "motorcycle/motor scooter",
    "screen": "tv/screen/monitor",
    "shelf": "bookcase",
    "ship": "boat/liner/container ship/schooner/pirate",
    "shirt": "jersey/sweatshirt",
    "shoe": "running shoe/loafer/clog/sandal",
    "sign": "street sign/stop sign",
    "skyscraper": "obelisk",
    "smartphone": "cell phone",
    "sofa": "couch",
    "statue": "pedestal/totem pole",
    "stove": "oven/stove",
    "sweater": "cardigan/sweatshirt",
    "t-shirt": "jersey",
    "table": "dining table/desk",
    "teacup": "cup",
    "teddy": "teddy bear",
    "television": "tv",
    "telephone": "cell phone/dial telephone",
    "tower": "bell cote/church/beacon/water tower/obelisk/castle",
    "toy": "teddy bear/toyshop",
    "trash can": "ashcan",
    "trousers": "jean",
    "truck": "truck",
    "tv set": "tv",
    "van": "car/minivan/moving van",
    "vehicle": "car/truck/bus/motorcycle",
    "wardrobe": "wardrobe",
    "waste bin": "ashcan",
    "watch": "digital watch",
    "wheel": "car wheel",
    "window": "window screen/window shade",
    "woman": "person",
}
DOGS = range(151, 269)  # ImageNet has 118 breeds


def coco_classes(text: str) -> tuple[int, ...]:
    """Places in COCO of what a text names; () where COCO has no such thing."""
    return _classes(text, _by_name(tuple((name,) for name in COCO)))


def imagenet_classes(text: str) -> tuple[int, ...]:
    """Places in ImageNet's 1,000 classes of what a text names; () where it has no such thing."""
    names = _by_name(tuple(tuple(line.split(", ")) for line in imagenet_names()))
    return _classes(text, names | {"dog": tuple(DOGS)})


@cache
def imagenet_names() -> tuple[str, ...]:
    """A line of names that mean the same for each class of ImageNet, in order."""
    text = Path(__file__).with_name("imagenet.txt").read_text(encoding="utf-8")
    return tuple(line for line in text.splitlines() if not line.startswith("#"))


@cache
def _by_name(classes: tuple[tuple[str, ...], ...]) -> dict[str, tuple[int, ...]]:
    """Places of the classes that a name means: those with that name, else those that end in it."""
    whole: dict[str, list[int]] = {}
    heads: dict[str, list[int]] = {}
    for place, names in enumerate(classes):
        for name in names:
            whole.setdefault(name, []).append(place)
        if " " in names[0]:
            heads.setdefault(names[0].split()[-1], []).append(place)
    return {name: tuple(places) for name, places in (heads | whole).items()}


def _classes(text: str, known: dict[str, tuple[int, ...]]) -> tuple[int, ...]:
    """The classes of the longest end of the text that means something: "old red mug" is a mug."""
    words = plain(text).split()
    for start in range(len(words)):
        for name in _forms(" ".join(words[start:])):
            names = [*SYNONYMS.get(name, "").split("/"), name]
            found = [place for one in names for place in known.get(one, ())]
            if found:
                return tuple(dict.fromkeys(found))
    return ()


def _forms(name: str) -> list[str]:
    """A name as it is, and as one of several: "cups" is "cup"."""
    forms = [name]
    if name.endswith("ies"):
        forms.append(name[:-3] + "y")
    if name.endswith(("ches", "shes", "xes", "sses")):
        forms.append(name[:-2])
    if name.endswith("s") and not name.endswith("ss"):
        forms.append(name[:-1])
    return forms
