"""PSNR and SSIM of formula-made images, computed by scikit-image.

usage: python make_images.py        (pip install numpy scikit-image)

Prints the expected values of tests/image_quality.rs, which makes the same images by the same formulas.
"""
import numpy as np
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio, structural_similarity


def images(width, height):
    v, u, c = np.mgrid[0:height, 0:width, 0:3]
    target = (3 * u + 2 * v + 40 * c + (u // 4 + v // 3) % 2 * 90) % 256
    noise = (7 * u * u + 13 * v + 5 * c * u + u * v) % 41 / 100 - 0.2
    render = (target / 255 + noise).astype(np.float32)  # reaches below 0 and beyond 1
    depth = (u[..., 0] + 2 * v[..., 0]) % 7 > 1
    return np.clip(render.astype(np.float64), 0, 1), target / 255, depth


for width, height in ((48, 37), (11, 11), (23, 64)):
    render, target, depth = images(width, height)
    zeroed = depth[..., None]
    print(
        f"({width}, {height}):"
        f" psnr {peak_signal_noise_ratio(target, render, data_range=1):.15g}"
        f" valid_depth {-10 * np.log10(mean_squared_error(target[depth], render[depth])):.15g}"
        f" paper {peak_signal_noise_ratio(target * zeroed, render * zeroed, data_range=1):.15g} ssim",
        "%.15g" % structural_similarity(
            target, render, data_range=1, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        ),
    )
