"""Tiny networks with random weights in the real code of transformers, saved as the hub's folders are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

WORDS = ("dirt", "soil", "road", "grass", "excavator", "arm", "traffic", "cone", "sky", "digger")

PROMPTS = """
[prompts]
construction_terrain = ["dirt", "soil"]
other_terrain = ["road"]
removable_cover = ["grass"]
excavator = ["excavator", "digger arm"]
obstacle = ["traffic cone"]
no_surface = ["sky"]
"""


def clip_tokenizer(folder: Path) -> int:
    """A CLIP tokenizer that knows letters only; returns the size of its vocabulary."""
    from transformers import CLIPTokenizer

    letters = [chr(c) for c in range(ord("a"), ord("z") + 1)]
    tokens = [*letters, *(c + "</w>" for c in letters), "<|startoftext|>", "<|endoftext|>"]
    (folder / "vocab.json").write_text(json.dumps({token: i for i, token in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt")).save_pretrained(folder)
    return len(tokens)


def bert_tokenizer(folder: Path) -> int:
    """A BERT tokenizer with the special tokens at the ids that Grounding DINO has built in."""
    from transformers import BertTokenizer

    tokens = [f"[unused{i}]" for i in range(1040)]
    tokens[0], tokens[100], tokens[101], tokens[102], tokens[103] = "[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]"
    tokens[1012], tokens[1029] = ".", "?"
    for i, word in enumerate(WORDS):
        tokens[200 + i] = word
    (folder / "vocab.txt").write_text("\n".join(tokens) + "\n")
    BertTokenizer(str(folder / "vocab.txt"), do_lower_case=True).save_pretrained(folder)
    return len(tokens)


def sam3(folder: Path) -> Path:
    """A SAM 3 of 112 px."""
    import torch
    from transformers import Sam3Config, Sam3Model

    size = clip_tokenizer(folder)
    small = {"hidden_size": 32, "num_attention_heads": 2, "intermediate_size": 32}
    config = Sam3Config(
        vision_config={
            "backbone_config": {
                "model_type": "sam3_vit_model",
                **small,
                "num_hidden_layers": 2,
                "image_size": 112,
                "patch_size": 14,
                "window_size": 4,
                "global_attn_indexes": [1],
                "pretrain_image_size": 56,
            },
            "fpn_hidden_size": 32,
            "backbone_feature_sizes": [[32, 32], [16, 16], [8, 8]],
        },
        text_config={
            "model_type": "clip_text_model",
            "vocab_size": size,
            **small,
            "projection_dim": 16,
            "num_hidden_layers": 1,
            "max_position_embeddings": 32,
            "bos_token_id": size - 2,
            "eos_token_id": size - 1,
            "pad_token_id": size - 1,
        },
        geometry_encoder_config={**small, "num_layers": 1},
        detr_encoder_config={**small, "num_layers": 1},
        detr_decoder_config={**small, "num_layers": 1, "num_queries": 7},
        mask_decoder_config={"hidden_size": 32, "num_attention_heads": 2},
    )
    torch.manual_seed(3)
    _lively(Sam3Model(config)).save_pretrained(folder)
    return folder


def _lively(network: Any) -> Any:
    """With weights large enough that prompts, places and queries differ; a fresh network says the same everywhere."""
    import torch

    for parameter in network.parameters():
        if parameter.ndim > 1:
            torch.nn.init.xavier_normal_(parameter, 1.5)
    return network.eval()


def clipseg(folder: Path) -> Path:
    """A CLIPSeg of 64 px."""
    import torch
    from transformers import CLIPSegConfig, CLIPSegForImageSegmentation

    size = clip_tokenizer(folder)
    small = {"hidden_size": 32, "num_attention_heads": 2, "intermediate_size": 32, "num_hidden_layers": 3}
    ends = {"bos_token_id": size - 2, "eos_token_id": size - 1, "pad_token_id": size - 1}
    config = CLIPSegConfig(
        text_config={"vocab_size": size, "max_position_embeddings": 24, **small, **ends},
        vision_config={"image_size": 32, "patch_size": 8, **small},
        projection_dim=16,
        extract_layers=[0, 1, 2],
        reduce_dim=16,
        decoder_num_attention_heads=2,
        decoder_intermediate_size=16,
        conditional_layer=0,
    )
    torch.manual_seed(4)
    network = CLIPSegForImageSegmentation(config).eval()
    with torch.no_grad():  # random weights say almost the same everywhere; larger ones make maps that vary
        for parameter in network.decoder.parameters():
            parameter.mul_(3)
    network.save_pretrained(folder)
    return folder


def grounding_dino(folder: Path) -> Path:
    """A Grounding DINO that reads 24 tokens at a time."""
    import torch
    from transformers import GroundingDinoConfig, GroundingDinoForObjectDetection

    size = bert_tokenizer(folder)
    config = GroundingDinoConfig(
        backbone_config={
            "model_type": "swin",
            "embed_dim": 16,
            "depths": [1, 1, 1, 1],
            "num_heads": [1, 1, 1, 1],
            "window_size": 2,
            "out_indices": [2, 3, 4],
        },
        text_config={
            "model_type": "bert",
            "vocab_size": size,
            "hidden_size": 16,
            "num_hidden_layers": 1,
            "num_attention_heads": 2,
            "intermediate_size": 16,
            "max_position_embeddings": 64,
        },
        d_model=32,
        encoder_layers=1,
        decoder_layers=2,
        encoder_ffn_dim=32,
        decoder_ffn_dim=32,
        encoder_attention_heads=2,
        decoder_attention_heads=2,
        num_queries=9,
        num_feature_levels=4,
        max_text_len=24,
    )
    torch.manual_seed(5)
    GroundingDinoForObjectDetection(config).eval().save_pretrained(folder)
    return folder


def sam(folder: Path) -> Path:
    """A SAM of 64 px, which pads."""
    import torch
    from transformers import SamConfig, SamModel

    config = SamConfig(
        vision_config={
            "hidden_size": 32,
            "output_channels": 32,
            "num_hidden_layers": 1,
            "num_attention_heads": 2,
            "image_size": 64,
            "patch_size": 16,
            "window_size": 2,
            "global_attn_indexes": [0],
            "mlp_dim": 32,
            "num_pos_feats": 16,
        },
        prompt_encoder_config={"hidden_size": 32, "image_size": 64, "patch_size": 16, "mask_input_channels": 4},
        mask_decoder_config={
            "hidden_size": 32,
            "mlp_dim": 32,
            "num_hidden_layers": 1,
            "num_attention_heads": 2,
            "iou_head_hidden_dim": 32,
        },
    )
    torch.manual_seed(6)
    _sure(SamModel(config)).save_pretrained(folder)
    return folder


def _sure(network: Any) -> Any:
    """Its masks are predicted to be good, IoU about 0.75: random heads say about 0, and then there is no evidence."""
    import torch

    with torch.no_grad():
        network.mask_decoder.iou_prediction_head.proj_out.bias.fill_(0.75)
    return network.eval()


def sam2(folder: Path) -> Path:
    """A SAM 2 of 64 px, which stretches."""
    import torch
    from transformers import Sam2Config, Sam2Model

    config = Sam2Config(
        vision_config={
            "backbone_config": {
                "model_type": "sam2_hiera_det_model",
                "hidden_size": 8,
                "num_attention_heads": 1,
                "image_size": [64, 64],
                "blocks_per_stage": [1, 1, 2, 1],
                "embed_dim_per_stage": [8, 16, 32, 64],
                "num_attention_heads_per_stage": [1, 1, 1, 1],
                "window_size_per_stage": [4, 2, 2, 2],
                "global_attention_blocks": [3],
                "window_positional_embedding_background_size": [4, 4],
            },
            "backbone_channel_list": [64, 32, 16, 8],
            "backbone_feature_sizes": [[16, 16], [8, 8], [4, 4]],
            "fpn_hidden_size": 32,
        },
        prompt_encoder_config={"hidden_size": 32, "image_size": 64, "patch_size": 16, "mask_input_channels": 4},
        mask_decoder_config={
            "hidden_size": 32,
            "mlp_dim": 32,
            "num_hidden_layers": 1,
            "num_attention_heads": 2,
            "iou_head_hidden_dim": 32,
        },
    )
    torch.manual_seed(7)
    _sure(Sam2Model(config)).save_pretrained(folder)
    return folder
