"""Golden masks of the Fourier segmentation, from OpenCV (CLAHE, triangle threshold) and NumPy (float64 FFT).

usage: python make.py        (pip install numpy opencv-python-headless)

Draws gray_WxH.png here and writes beside it the masks mask_plain_WxH.png and mask_clahe_WxH.png
and, of some, the equalised image equalized_WxH.png (without padding).
"""
import pathlib
import cv2
import numpy as np

HERE = pathlib.Path(__file__).parent
PADDING = 10
SIZES = [(320, 240), (333, 215), (181, 300), (97, 61), (300, 172), (20, 44)]
EQUALIZED_SIZES = [(20, 44), (333, 215), (320, 181), (320, 192)]


def draw(width, height):
    """Flat walls, a ramp, checks of several sizes, a striped disc, noise and thin lines; integers only."""
    v, u = np.mgrid[0:height, 0:width]
    image = 60 + 80 * u // width + 40 * v // height
    left = u < width // 3
    image[left & (v < height // 2)] = 150
    for column, size in enumerate((2, 5, 11)):
        start = width // 3 + column * width // 6
        inside = (u >= start) & (u < start + width // 7) & (v > height // 8) & (v < height // 3)
        image[inside & ((u // size + v // size) % 2 == 0)] = 210 - 30 * column
    distance2 = (u - width // 4) ** 2 + (v - 3 * height // 4) ** 2
    disc = distance2 < (min(width, height) // 5) ** 2
    image[disc] = 90 + 60 * (distance2[disc] // (4 * min(width, height)) % 2)
    state, noise = 12345, np.zeros((height, width), int)
    for y in range(height // 2, height):
        for x in range(2 * width // 3, width):
            state = (1103515245 * state + 12345) % 2**31
            noise[y, x] = (state >> 16) % 24
    image = image + noise
    image[(3 * u + 5 * v) % 97 < 2] += 35
    return np.clip(image, 0, 255).astype(np.uint8)


def equalize(gray):
    return cv2.createCLAHE(clipLimit=2.0, tileGridSize=(32, 32)).apply(gray)


def write(name, image):
    cv2.imwrite(str(HERE / f"{name}.png"), image)


def high_frequency_mask(gray, clahe):
    height, width = gray.shape
    padded = cv2.copyMakeBorder(gray, *[PADDING] * 4, cv2.BORDER_REFLECT_101)
    if clahe:
        padded = equalize(padded)
    bins_v, bins_u = (np.fft.fftfreq(size, 1 / size) for size in padded.shape)
    cutoff = min(height, width) // 20
    high_pass = 1 - np.exp(-(bins_v[:, None] ** 2 + bins_u**2) / (2 * cutoff**2))
    spectrum = np.fft.fft2(padded.astype(np.float64)) * high_pass
    response = np.abs(np.fft.ifft2(spectrum).real)[PADDING:-PADDING, PADDING:-PADDING]
    level = 255 * (response - response.min()) / (response.max() - response.min())
    return cv2.threshold(np.round(level).astype(np.uint8), 0, 255, cv2.THRESH_TRIANGLE)[1]


for width, height in SIZES:
    gray = draw(width, height)
    write(f"gray_{width}x{height}", gray)
    for kind in ("plain", "clahe"):
        mask = high_frequency_mask(gray, kind == "clahe")
        write(f"mask_{kind}_{width}x{height}", mask)
        print(f"{width}x{height} {kind}: {np.mean(mask > 0):.4f} high")
for width, height in EQUALIZED_SIZES:
    gray = draw(width, height)
    write(f"gray_{width}x{height}", gray)
    write(f"equalized_{width}x{height}", equalize(gray))
