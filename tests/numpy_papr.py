"""PAPR's forward pass in float64 numpy, on tensors under the original's names.

Written from the description of the original (names, shapes, formulas) without looking at `pcore`,
so that the two can disagree.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

Arrays = Mapping[str, np.ndarray]
EMBED = "proximity_attn.embed.embed_"


def forward(
    state: Arrays,
    origins: np.ndarray,
    directions: np.ndarray,
    *,
    coord_scale: float,
    constant: float,
    slope: float,
) -> dict[str, np.ndarray]:
    """Render (H, W, 3) rays in world units; `surface` comes back in world units."""
    state = {name: np.asarray(value, dtype=np.float64) for name, value in state.items()}
    height, width = directions.shape[:2]
    d = directions.reshape(-1, 3).astype(np.float64)
    o = origins.reshape(-1, 3).astype(np.float64) * coord_scale
    k = int(state["select_k"])
    nearest = nearest_points(o, d, state["points"], k)
    p = state["points"][nearest]
    v = p - o[:, None]
    h = (v * d[:, None]).sum(-1, keepdims=True) * d[:, None] / (1 + 1e-6)
    t = v - h
    key = normalised(state, "k", np.concatenate([gamma(p), gamma(h), gamma(t)], -1), slope)
    query = normalised(state, "q", gamma(d), slope)
    mu = state["pc_feats"][nearest]
    value = mlp(state, "v", np.concatenate([gamma(h), gamma(t), mu], -1), slope)
    key = linear(state, "proximity_attn.attention_layer.w_k", key)
    query = linear(state, "proximity_attn.attention_layer.w_q", query)
    scores = np.maximum(np.einsum("rc,rkc->rk", query, key) / np.sqrt(key.shape[-1]), 0)
    scores = scores * state["points_influ_scores"][:, 0][nearest]
    scores = np.concatenate([scores, np.full((len(scores), 1), constant)], -1)
    attention = np.exp(scores - scores.max(-1, keepdims=True))
    attention /= attention.sum(-1, keepdims=True)
    weights = attention[:, :-1] / attention[:, :-1].sum(-1, keepdims=True)
    features = np.einsum("rk,rkc->rc", weights, value).reshape(height, width, -1)
    background = attention[:, -1].reshape(height, width, 1)
    colours = unet(state, features.transpose(2, 0, 1)).transpose(1, 2, 0)
    return {
        "rgb": colours * (1 - background) + state["bkg_feats"][0] * background,
        "alpha": 1 - background[..., 0],
        "features": features,
        "surface": np.einsum("rk,rkc->rc", weights, p).reshape(height, width, 3) / coord_scale,
        "neighbours": np.sort(nearest, -1).reshape(height, width, -1),
    }


def nearest_points(o: np.ndarray, d: np.ndarray, points: np.ndarray, k: int) -> np.ndarray:
    """Indices (R, k) by the length of the cross product with the unit direction."""
    distance = np.linalg.norm(np.cross(points[None] - o[:, None], d[:, None]), axis=-1)
    return np.argsort(distance, axis=-1, kind="stable")[:, :k]


def gamma(x: np.ndarray) -> np.ndarray:
    blocks = []
    for axis in range(x.shape[-1]):
        scalar = x[..., axis]
        blocks.append(scalar)
        for octave in range(6):
            blocks += [np.sin(2**octave * scalar), np.cos(2**octave * scalar)]
    return np.stack(blocks, -1)


def linear(state: Arrays, name: str, x: np.ndarray) -> np.ndarray:
    return x @ state[f"{name}.weight"].T + state[f"{name}.bias"]


def mlp(state: Arrays, net: str, x: np.ndarray, slope: float) -> np.ndarray:
    names = [f"{EMBED}{net}.mlp.model.{i}" for i in range(1, 40, 2)]
    names = [name for name in names if f"{name}.weight" in state]
    out = x
    for i, name in enumerate(names):
        if state[f"{name}.weight"].shape[1] != out.shape[-1]:
            assert (net, i) == ("v", 5), "only the sixth layer of the value network takes the input"
            out = np.concatenate([out, x], -1)
        out = linear(state, name, out)
        if i < len(names) - 1:
            out = np.where(out > 0, out, slope * out)
    return out


def normalise(state: Arrays, name: str, x: np.ndarray) -> np.ndarray:
    centred = x - x.mean(-1, keepdims=True)
    return (
        state[f"{name}.a_2"] * centred / (x.std(-1, ddof=1, keepdims=True) + 1e-6)
        + state[f"{name}.b_2"]
    )


def normalised(state: Arrays, net: str, x: np.ndarray, slope: float) -> np.ndarray:
    inside = mlp(state, net, normalise(state, f"{EMBED}{net}.innorm", x), slope)
    return normalise(state, f"{EMBED}{net}.outnorm", inside)


def unet(state: Arrays, x: np.ndarray) -> np.ndarray:
    full = np.maximum(conv(state, "renderer.inc.double_conv.0", x), 0)
    half = np.maximum(conv(state, "renderer.down1.maxpool_conv.1.double_conv.0", pool(full)), 0)
    low = np.maximum(conv(state, "renderer.down2.maxpool_conv.1.double_conv.0", pool(half)), 0)
    for name, skip in (("renderer.up1", half), ("renderer.up2", full)):
        joined = np.concatenate([skip, pad_to(upsample(state, f"{name}.up", low), skip)])
        low = np.maximum(conv(state, f"{name}.conv.double_conv.0", joined), 0)
    return conv(state, "renderer.outc.conv", low)


def conv(state: Arrays, name: str, x: np.ndarray) -> np.ndarray:
    """Same-size convolution of (C, H, W)."""
    weight = state[f"{name}.weight"]
    margin = weight.shape[-1] // 2
    padded = np.pad(x, ((0, 0), (margin, margin), (margin, margin)))
    out = np.zeros((weight.shape[0], *x.shape[1:])) + state[f"{name}.bias"][:, None, None]
    for i in range(weight.shape[2]):
        for j in range(weight.shape[3]):
            shifted = padded[:, i : i + x.shape[1], j : j + x.shape[2]]
            out += np.einsum("oc,chw->ohw", weight[:, :, i, j], shifted)
    return out


def pool(x: np.ndarray) -> np.ndarray:
    h, w = x.shape[1] // 2, x.shape[2] // 2
    return x[:, : 2 * h, : 2 * w].reshape(-1, h, 2, w, 2).max((2, 4))


def upsample(state: Arrays, name: str, x: np.ndarray) -> np.ndarray:
    """Transposed convolution 2 x 2 with stride 2: every pixel becomes a block of four."""
    weight = state[f"{name}.weight"]
    out = np.zeros((weight.shape[1], 2 * x.shape[1], 2 * x.shape[2]))
    for i in range(2):
        for j in range(2):
            out[:, i::2, j::2] = np.einsum("chw,co->ohw", x, weight[:, :, i, j])
    return out + state[f"{name}.bias"][:, None, None]


def pad_to(x: np.ndarray, like: np.ndarray) -> np.ndarray:
    rows, columns = like.shape[1] - x.shape[1], like.shape[2] - x.shape[2]
    top, left = rows // 2, columns // 2
    return np.pad(x, ((0, 0), (top, rows - top), (left, columns - left)))
