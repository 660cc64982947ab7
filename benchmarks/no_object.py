"""What the mass of "no object" should do to the evidence of a mask-classification network: a measured choice.

    python benchmarks/no_object.py [--queries 100] [--seed 0] [--steps 2000]

A small Mask2Former of transformers' own code is trained on the CPU (some 12 minutes) to segment textured shapes of five
classes, then asked about pictures that also hold things it has never seen. Three ways to evidence are compared, with
S_v = sum_q P_q(v) m_q, R = sum_v S_v and N = sum_q P_q(no object) m_q at a pixel:

    S / max(1, R)        "no object" takes the room that is left (what the adapters do)
    S / max(1, R + N)    "no object" competes for room
    S / max(1, R + n)    only the strongest "no object" does, n = max_q P_q(no object) m_q

Needs torch, transformers and scipy (make test-backbones sets them up).
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import torch
from scipy import ndimage
from transformers import Mask2FormerConfig, Mask2FormerForUniversalSegmentation, SwinConfig

SIDE, CLASSES = 64, 5
#: Means of the classes' colours (RGB); the first is the ground.
COLOURS = np.array([[90, 80, 70], [200, 60, 50], [60, 160, 70], [70, 90, 200], [210, 200, 80]], float)
NEVER_SEEN = np.array([200.0, 80.0, 210.0])


def scene(rng: np.random.Generator, odd: bool) -> tuple[np.ndarray, np.ndarray]:
    """A picture (SIDE, SIDE, 3) and its labels; ``odd`` puts one thing in that belongs to no class (label CLASSES)."""
    image = COLOURS[0] + rng.normal(0, 14, (SIDE, SIDE, 1)) + rng.normal(0, 10, (SIDE, SIDE, 3))
    label = np.zeros((SIDE, SIDE), int)
    y, x = np.mgrid[:SIDE, :SIDE]
    for k in [*rng.integers(1, CLASSES, rng.integers(2, 5)), *([CLASSES] if odd else [])]:
        cy, cx, r = *rng.uniform(8, SIDE - 8, 2), rng.uniform(7, 14)
        round_ = (y - cy) ** 2 + (x - cx) ** 2 < r * r
        inside = round_ if rng.random() < 0.5 else (abs(y - cy) < r) & (abs(x - cx) < r * rng.uniform(0.6, 1.4))
        if k == CLASSES:
            looks = NEVER_SEEN + 40 * np.sign(np.sin(x * 1.3))[..., None]
        else:
            looks = COLOURS[k] + rng.normal(0, 22, 3) + 12 * np.sin((x * (k % 2) + y * (k // 2)) * 0.8)[..., None]
        image = np.where(inside[..., None], looks + rng.normal(0, 10, image.shape), image)
        label = np.where(inside, k, label)
    return np.clip(image, 0, 255).astype(np.uint8), label


def batch(rng: np.random.Generator, count: int, odd: bool = False) -> tuple[torch.Tensor, np.ndarray]:
    """Normalised pictures (count, 3, SIDE, SIDE) and their labels."""
    images, labels = zip(*(scene(rng, odd) for _ in range(count)), strict=True)
    pixels = torch.tensor(np.stack(images)).permute(0, 3, 1, 2).float() / 255
    return (pixels - 0.45) / 0.25, np.stack(labels)


def network(queries: int) -> Any:
    """A Mask2Former with half a million parameters."""
    swin = SwinConfig(
        image_size=SIDE,
        embed_dim=24,
        depths=[1, 1, 2, 1],
        num_heads=[1, 2, 2, 4],
        window_size=4,
        out_features=["stage1", "stage2", "stage3", "stage4"],
    )
    config = Mask2FormerConfig(
        backbone_config=swin,
        feature_size=32,
        mask_feature_size=32,
        hidden_dim=32,
        encoder_feedforward_dim=96,
        dim_feedforward=96,
        encoder_layers=2,
        decoder_layers=4,
        num_attention_heads=4,
        num_queries=queries,
        num_labels=CLASSES,
        train_num_points=1024,
        dropout=0.0,
    )
    return Mask2FormerForUniversalSegmentation(config)


def trained(queries: int, seed: int, steps: int) -> Any:
    """The network after ``steps`` batches of eight pictures."""
    torch.manual_seed(seed)
    model, rng = network(queries).train(), np.random.default_rng(1)
    optimiser = torch.optim.AdamW(model.parameters(), lr=8e-4, weight_decay=0.01)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 8e-4, total_steps=steps, pct_start=0.1)
    for step in range(steps):
        pixels, labels = batch(rng, 8)
        present = [np.unique(label) for label in labels]
        masks = [
            torch.tensor(np.stack([label == k for k in ks])).float() for label, ks in zip(labels, present, strict=True)
        ]
        loss = model(pixel_values=pixels, mask_labels=masks, class_labels=[torch.tensor(ks) for ks in present]).loss
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 0.5)
        optimiser.step()
        schedule.step()
        if step % 100 == 0:
            print(f"step {step}: loss {loss.item():.2f}", flush=True)
    return model.eval()


def things(labels: np.ndarray, value: np.ndarray, ks: range) -> np.ndarray:
    """Mean of ``value`` over each connected thing of the classes ``ks`` that has at least 40 pixels."""
    means = []
    for label, values in zip(labels, value, strict=True):
        for k in ks:
            parts, count = ndimage.label(label == k)
            sizes = ndimage.sum_labels(np.ones_like(label), parts, range(1, count + 1))
            found = ndimage.mean(values, parts, range(1, count + 1))
            means += [mean for mean, size in zip(np.atleast_1d(found), np.atleast_1d(sizes), strict=True) if size >= 40]
    return np.array(means)


def main() -> None:
    """Train, ask, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--queries", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=2000)
    args = parser.parse_args()
    model = trained(args.queries, args.seed, args.steps)
    pixels, labels = batch(np.random.default_rng(2), 100, odd=True)
    with torch.inference_mode():
        told = model(pixel_values=pixels)
        P = told.class_queries_logits.softmax(-1)
        size = (SIDE, SIDE)
        m = torch.nn.functional.interpolate(told.masks_queries_logits, size=size, mode="bilinear").sigmoid()
        S = torch.einsum("bqv,bqhw->bvhw", P[..., :-1], m)
        N = torch.einsum("bq,bqhw->bhw", P[..., -1], m)
        n = (P[..., -1, None, None] * m).amax(1)
    R, known = S.sum(1), labels < CLASSES
    right = float((S.argmax(1).numpy() == labels)[known].mean())
    print(f"{args.queries} queries, seed {args.seed}: {100 * right:.1f} % of the pixels of known classes right")
    print(f"mass at a known pixel: classes {R[known].mean():.2f}, no object {N[known].mean():.2f}")
    for name, room in (("S / max(1, R)", R), ("S / max(1, R + N)", R + N), ("S / max(1, R + n)", R + n)):
        p = (S / room.clamp(min=1)[:, None]).numpy()
        true = np.take_along_axis(p, np.minimum(labels, CLASSES - 1)[:, None], 1)[:, 0]
        lost = np.mean(things(labels, true, range(1, CLASSES)) < 0.5)
        told_apart = np.mean(things(labels, p.sum(1), range(CLASSES, CLASSES + 1)) < 0.5)
        print(
            f"{name:18s} evidence for the true class of known pixels {true[known].mean():.3f}; known things that lose "
            f"theirs (mean < 0.5) {100 * lost:.1f} %; evidence on never-seen things {p.sum(1)[~known].mean():.3f}, "
            f"of which left unknown (sum < 0.5) {100 * told_apart:.1f} %"
        )


if __name__ == "__main__":
    main()
