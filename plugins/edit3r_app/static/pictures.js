// Drawn pictures of the first page: a vase on a table, as photos of it are taken, edited and turned.

const picture = (label, inside, box = "0 0 240 150") =>
  `<svg viewBox="${box}" role="img" aria-label="${label}" class="drawn"><rect width="100%" height="100%" fill="#dfe6f2"/>${inside}</svg>`;
// A vase about (x, y), its foot; `turn` moves its lit side.
const vase = (x, y, s = 1, colour = "#3f7fc4", turn = 0) =>
  `<g transform="translate(${x} ${y}) scale(${s})"><ellipse cy="2" rx="24" ry="5" fill="#0003"/>
  <path d="M-9-62h18c0 14 17 20 17 40C26-8 18 0 12 0h-24C-18 0-26-8-26-22c0-20 17-26 17-40z" fill="${colour}"/>
  <path d="M${-14 + turn}-40c-7 9-8 22-2 32" fill="none" stroke="#fff9" stroke-width="4" stroke-linecap="round"/><ellipse cy="-62" rx="10" ry="3" fill="#0005"/></g>`;
const table = (y = 108) =>
  `<path d="M0 ${y}h240v60H0z" fill="#b98d62"/><path d="M0 ${y}h240v4H0z" fill="#d6ad80"/>`;
const phone = (x, y, angle) =>
  `<g transform="translate(${x} ${y}) rotate(${angle})"><rect x="-11" y="-18" width="22" height="36" rx="4" fill="#26262e"/><rect x="-8" y="-14" width="16" height="26" fill="#9fc3ee"/></g>`;
const dotted = (d) =>
  `<path d="${d}" fill="none" stroke="#26262e" stroke-width="1.5" stroke-dasharray="3 4"/>`;

export const STORY = [
  [
    picture(
      "two phones photograph a vase from two places",
      table() +
        vase(120, 118) +
        phone(48, 112, 20) +
        phone(196, 112, -20) +
        dotted("M58 104L104 84M186 104L138 84"),
    ),
    "1. Take two photos",
    "of one thing, a step to the side between them.",
  ],
  [
    picture(
      "a pointer outlines the vase, and a sentence says: paint it golden",
      table() +
        vase(120, 118) +
        `<path d="M111 56h18c0 14 17 20 17 40 0 14-8 22-14 22h-24c-6 0-14-8-14-22 0-20 17-26 17-40z" fill="none" stroke="#fff" stroke-width="3" stroke-dasharray="6 3"/>
    <path d="M134 88l16 12-8 2-3 8z" fill="#17171c" stroke="#fff"/><rect x="20" y="14" width="126" height="26" rx="13" fill="#fff"/><text x="34" y="31" font-size="13" fill="#17171c" font-family="system-ui, sans-serif">paint it golden</text>`,
    ),
    "2. Point and say",
    "what should change: a colour, a material, a look, or the thing itself.",
  ],
  [
    picture(
      "the golden vase, seen from three sides",
      table() +
        vase(58, 116, 0.72, "#d9a520", -4) +
        vase(120, 122, 1, "#d9a520") +
        vase(184, 116, 0.72, "#d9a520", 12) +
        dotted("M30 134c50 20 130 20 180 0") +
        `<path d="M214 126l-2 10-9-4z" fill="#26262e"/>`,
    ),
    "3. Turn it in 3D",
    "compare before and after, and download it.",
  ],
];

const frame = (x, y, inside, turn = 0) =>
  `<g transform="translate(${x} ${y}) rotate(${turn})"><clipPath id="c${x}${y}"><rect width="104" height="78" rx="4"/></clipPath><g clip-path="url(#c${x}${y})"><rect width="104" height="78" fill="#dfe6f2"/>${inside}</g><rect width="104" height="78" rx="4" fill="none" stroke="#26262e" stroke-width="1.5"/></g>`;
const floor = `<path d="M0 56h104v30H0z" fill="#b98d62"/>`;
const two = (label, a, b) => picture(label, frame(10, 14, a) + frame(126, 14, b), "0 0 240 106");
const cup = (x) => `<rect x="${x}" y="48" width="14" height="14" rx="2" fill="#c65b4b"/>`;

// [picture, whether photos like these work, what to do]
export const ADVICE = [
  [
    two(
      "two photos of the vase, the second from a step to the side",
      floor + cup(22) + vase(52, 62, 0.8),
      floor + cup(12) + vase(50, 62, 0.8, "#3f7fc4", 8),
    ),
    true,
    "A step aside, the thing in both photos, things around it in view.",
  ],
  [
    two(
      "two photos that are the same",
      floor + cup(22) + vase(52, 62, 0.8),
      floor + cup(22) + vase(52, 62, 0.8),
    ),
    false,
    "Twice from one place: nothing tells near from far.",
  ],
  [
    two(
      "one photo from the front, one from behind",
      floor + cup(22) + vase(52, 62, 0.8),
      `<rect width="104" height="86" fill="#6d8f6a"/><path d="M0 60h104v26H0z" fill="#8a6a48"/>` +
        vase(52, 66, 0.8, "#2c5f98", 20),
    ),
    false,
    "From opposite sides: the photos share too little. Take some between.",
  ],
  [
    two(
      "two photos of a plain wall",
      `<rect width="104" height="86" fill="#e9e4da"/>`,
      `<rect width="104" height="86" fill="#e6e0d4"/>`,
    ),
    false,
    "A bare wall or a mirror has nothing to be found again by.",
  ],
];
