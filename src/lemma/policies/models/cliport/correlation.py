"""Cross-correlation of feature maps with large kernels, every sample with its own.

The kernels see a metre of table, so that multiplying spectra is far cheaper than
sliding them over the map.
"""

import torch
from torch import Tensor


def correlate(key: Tensor, kernels: Tensor) -> Tensor:
    """Correlate each sample's map with each of its kernels.

    Args:
        key: (B, C, rows, columns).
        kernels: (B, R, C, s, s) with s odd.

    Returns:
        (B, R, rows, columns) float32: how well the kernel fits with its middle on the
        cell; nothing lies outside the map.
    """
    rows, columns = key.shape[-2:]
    half = kernels.shape[-1] // 2
    # Values that wrap around must fall into the padding.
    size = (_fast(rows + half), _fast(columns + half))
    with torch.autocast(key.device.type, enabled=False):
        key_spectrum = torch.fft.rfft2(key.float(), s=size)
        kernel_spectra = torch.fft.rfft2(kernels.float(), s=size)
        product = (key_spectrum[:, None] * kernel_spectra.conj()).sum(2)
        fits = torch.fft.irfft2(product, s=size)
    return torch.roll(fits, (half, half), (-2, -1))[..., :rows, :columns]


def _fast(least: int) -> int:
    """Return the next number that has no prime factors but 2, 3 and 5."""
    size = least
    while True:
        rest = size
        for factor in (2, 3, 5):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return size
        size += 1
