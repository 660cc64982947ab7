"""Tiny random networks of transformers' own code, saved as the hub has them: what the adapters are tested on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from excavatwin.vocabularies import read_vocabulary

#: Classes of ADE20K by id, as they stand in ``id2label``.
ADE = dict(enumerate(read_vocabulary("ade20k-150").names.values()))


def save(kind: str, folder: Path, labels: dict[int, str] | None = ADE, seed: int = 0) -> Path:
    """Weights, config.json, preprocessor_config.json and, where it belongs, the tokenizer of one network."""
    import torch

    torch.manual_seed(seed)
    made = globals()[f"_{kind}"]({"id2label": labels} if labels else {"num_labels": 150})
    _enliven(made, {"segformer": 3000, "eomt_dinov3": 40}.get(kind, 8))
    made.save_pretrained(folder)
    (folder / "preprocessor_config.json").write_text(json.dumps(SETTINGS[kind]))
    if kind == "oneformer":
        _tokenizer(folder)
    return folder


def _enliven(network: Any, factor: float) -> None:
    """Random weights of the libraries' sizes say the same of every pixel; larger ones do not."""
    import torch

    with torch.no_grad():
        for name, values in network.named_parameters():
            if values.ndim > 1 and any(part in name for part in ("class", "mask_embedder", "mask_embed", "mask_head")):
                values.mul_(factor)


#: The forms in which the published weights have them, with small sides.
SETTINGS: dict[str, dict[str, Any]] = {
    "mask2former": {
        "size": {"shortest_edge": 96, "longest_edge": 192},
        "size_divisor": 32,
        "resample": 2,
        "rescale_factor": 1 / 255,
        "image_mean": [0.485, 0.456, 0.406],
        "image_std": [0.229, 0.224, 0.225],
    },
    "oneformer": {"size": {"shortest_edge": 96, "longest_edge": 192}, "resample": 2, "task_seq_length": 77},
    "segformer": {"size": 96, "resample": 2, "reduce_labels": True},
    "eomt": {"size": {"shortest_edge": 64, "longest_edge": None}, "do_split_image": True, "do_pad": False},
}
SETTINGS["eomt_dinov3"] = SETTINGS["eomt"]


def _swin() -> Any:
    from transformers import SwinConfig

    stages = ["stage1", "stage2", "stage3", "stage4"]
    return SwinConfig(
        image_size=64, embed_dim=16, depths=[1] * 4, num_heads=[1, 1, 2, 2], window_size=4, out_features=stages
    )


def _mask2former(classes: dict[str, Any]) -> Any:
    from transformers import Mask2FormerConfig, Mask2FormerForUniversalSegmentation

    config = Mask2FormerConfig(
        backbone_config=_swin(),
        feature_size=32,
        mask_feature_size=32,
        hidden_dim=32,
        encoder_feedforward_dim=32,
        dim_feedforward=32,
        encoder_layers=1,
        decoder_layers=3,
        num_attention_heads=2,
        num_queries=10,
        **classes,
    )
    return Mask2FormerForUniversalSegmentation(config)


def _oneformer(classes: dict[str, Any]) -> Any:
    from transformers import OneFormerConfig, OneFormerForUniversalSegmentation

    config = OneFormerConfig(
        backbone_config=_swin(),
        hidden_dim=32,
        mask_dim=32,
        conv_dim=32,
        encoder_feedforward_dim=32,
        dim_feedforward=32,
        encoder_layers=1,
        decoder_layers=2,
        num_attention_heads=2,
        num_queries=10,
        is_training=False,
        **classes,
    )
    return OneFormerForUniversalSegmentation(config)


def _segformer(classes: dict[str, Any]) -> Any:
    from transformers import SegformerConfig, SegformerForSemanticSegmentation

    config = SegformerConfig(
        hidden_sizes=[8, 8, 16, 16],
        depths=[1] * 4,
        num_attention_heads=[1, 1, 2, 2],
        decoder_hidden_size=16,
        **classes,
    )
    return SegformerForSemanticSegmentation(config)


_EOMT = {"hidden_size": 32, "num_hidden_layers": 3, "num_attention_heads": 2, "image_size": 64, "num_queries": 8}


def _eomt(classes: dict[str, Any]) -> Any:
    from transformers import EomtConfig, EomtForUniversalSegmentation

    return EomtForUniversalSegmentation(EomtConfig(**_EOMT, num_blocks=2, patch_size=16, **classes))


def _eomt_dinov3(classes: dict[str, Any]) -> Any:
    from transformers import EomtDinov3Config, EomtDinov3ForUniversalSegmentation

    sizes = _EOMT | {"intermediate_size": 32, "num_blocks": 2, "patch_size": 16}
    return EomtDinov3ForUniversalSegmentation(EomtDinov3Config(**sizes, **classes))


def _tokenizer(folder: Path) -> None:
    """CLIP's byte-pair tokenizer with letters only: the sentence of the task is spelt."""
    from transformers import CLIPTokenizer

    letters = "abcdefghijklmnopqrstuvwxyz"
    words = [*letters, *(f"{letter}</w>" for letter in letters), "<|startoftext|>", "<|endoftext|>"]
    CLIPTokenizer(vocab={word: i for i, word in enumerate(words)}, merges=[]).save_pretrained(folder)
