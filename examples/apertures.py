"""Makes aperture_coded.png and aperture_heart.png: python examples/apertures.py

The coded aperture is the modified uniformly redundant array of 13 x 13 cells by S. R. Gottesman and E. E. Fenimore,
"New family of binary arrays for coded aperture imaging", Applied Optics 28 (1989) 4344, with its square inside
of the rim of the lens.
"""

from pathlib import Path

import numpy as np

from clsco.files.images import write_png

FOLDER = Path(__file__).resolve().parent
PRIME, SIDE = 13, 19  # cells of the mask, and of the square around the rim


def coded() -> np.ndarray:
    """Closed in row 0, else open in column 0, and where both numbers or neither are squares modulo the prime."""
    squares = np.isin(np.arange(PRIME), np.arange(1, PRIME) ** 2 % PRIME)
    cells = squares[:, None] == squares[None, :]
    cells[:, 0] = True
    cells[0] = False
    return np.pad(np.where(cells, 255, 0).astype(np.uint8), (SIDE - PRIME) // 2)


def heart(count: int = 256) -> np.ndarray:
    """Transmission of the heart (x^2 + y^2 - a)^3 < b x^2 y^3."""
    at = (np.arange(count) + 0.5) * 2 / count - 1
    x, y = at[None, :], 0.1 - at[:, None]
    return np.where((x * x + y * y - 0.35) ** 3 < 1.2 * x * x * y**3, 255, 0).astype(np.uint8)


def main() -> None:
    write_png(FOLDER / "aperture_coded.png", coded())
    write_png(FOLDER / "aperture_heart.png", heart())


if __name__ == "__main__":
    main()
