"""Small networks at random weights, of the libraries' own classes, saved as the libraries save them."""

import json
import os


def clip(folder):
    """A CLIP text model with 24-dimensional embeddings, and a tokenizer that knows single letters."""
    import torch
    from transformers import CLIPTextConfig, CLIPTextModelWithProjection, CLIPTokenizer

    torch.manual_seed(1)
    letters = [chr(c) for c in range(97, 123)]
    words = ["<|startoftext|>", "<|endoftext|>", *letters, *(c + "</w>" for c in letters)]
    vocabulary, merges = os.path.join(folder, "vocab.json"), os.path.join(folder, "merges.txt")
    with open(vocabulary, "w", encoding="utf-8") as f:
        json.dump({word: i for i, word in enumerate(words)}, f)
    with open(merges, "w", encoding="utf-8") as f:
        f.write("#version: 0.2\n")
    CLIPTokenizer(vocabulary, merges).save_pretrained(folder)
    config = CLIPTextConfig(vocab_size=len(words), hidden_size=16, intermediate_size=32, projection_dim=24,
                            num_hidden_layers=2, num_attention_heads=2, max_position_embeddings=12, bos_token_id=0,
                            eos_token_id=1, pad_token_id=1)
    CLIPTextModelWithProjection(config).save_pretrained(folder)


def sam2(folder):
    """A SAM 2 for video and images that sees 128 pixels."""
    import torch
    from transformers import (Sam2HieraDetConfig, Sam2ImageProcessor, Sam2VideoConfig, Sam2VideoModel,
                              Sam2VideoProcessor, Sam2VideoVideoProcessor, Sam2VisionConfig)

    torch.manual_seed(2)
    side = 128
    backbone = Sam2HieraDetConfig(hidden_size=8, num_attention_heads=1, image_size=[side, side],
                                  blocks_per_stage=[1, 1, 2, 1], embed_dim_per_stage=[8, 16, 32, 64],
                                  num_attention_heads_per_stage=[1, 1, 2, 2], global_attention_blocks=[3],
                                  window_positional_embedding_background_size=[4, 4])
    vision = Sam2VisionConfig(backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8],
                              backbone_feature_sizes=[[side // 4] * 2, [side // 8] * 2, [side // 16] * 2],
                              fpn_hidden_size=256)
    config = Sam2VideoConfig(
        vision_config=vision, image_size=side, num_maskmem=3,
        prompt_encoder_config={"image_size": side, "patch_size": 16},
        memory_attention_num_layers=1, memory_attention_rope_feat_sizes=[side // 16, side // 16])
    Sam2VideoModel(config).save_pretrained(folder)
    size = {"height": side, "width": side}
    mask = {"height": side // 4, "width": side // 4}
    Sam2VideoProcessor(image_processor=Sam2ImageProcessor(size=size, mask_size=mask),
                       video_processor=Sam2VideoVideoProcessor(size=size), target_size=side).save_pretrained(folder)


def qwen(folder):
    """A Qwen3-VL of two layers, with a tokenizer of bytes."""
    import torch
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers
    from transformers import (PreTrainedTokenizerFast, Qwen2VLImageProcessor, Qwen3VLConfig,
                              Qwen3VLForConditionalGeneration, Qwen3VLProcessor, Qwen3VLVideoProcessor)

    torch.manual_seed(3)
    special = ["<|endoftext|>", "<|im_start|>", "<|im_end|>", "<|vision_start|>", "<|vision_end|>", "<|image_pad|>",
               "<|video_pad|>"]
    alphabet = sorted(pre_tokenizers.ByteLevel.alphabet())
    vocabulary = {word: i for i, word in enumerate([*special, *alphabet])}
    raw = Tokenizer(models.BPE(vocab=vocabulary, merges=[]))
    raw.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    raw.decoder = decoders.ByteLevel()
    template = ("{% for m in messages %}<|im_start|>{{ m.role }}\n{% for c in m.content %}{% if c.type == 'image' %}"
                "<|vision_start|><|image_pad|><|vision_end|>{% else %}{{ c.text }}{% endif %}{% endfor %}<|im_end|>\n"
                "{% endfor %}{% if add_generation_prompt %}<|im_start|>assistant\n{% endif %}")
    tokenizer = PreTrainedTokenizerFast(tokenizer_object=raw, eos_token="<|im_end|>", pad_token="<|endoftext|>",
                                        additional_special_tokens=special)
    tokenizer.image_token, tokenizer.video_token = "<|image_pad|>", "<|video_pad|>"
    Qwen3VLProcessor(
        image_processor=Qwen2VLImageProcessor(patch_size=16, size={"shortest_edge": 4096, "longest_edge": 65536}),
        tokenizer=tokenizer, video_processor=Qwen3VLVideoProcessor(), chat_template=template).save_pretrained(folder)
    size = {"num_attention_heads": 2, "hidden_size": 32, "intermediate_size": 64}
    config = Qwen3VLConfig(
        text_config={**size, "vocab_size": len(vocabulary), "num_hidden_layers": 2, "num_key_value_heads": 1,
                     "head_dim": 16, "eos_token_id": vocabulary["<|im_end|>"], "bos_token_id": None, "pad_token_id": 0,
                     "rope_scaling": {"rope_type": "default", "mrope_section": [4, 2, 2], "mrope_interleaved": True}},
        vision_config={"depth": 2, "hidden_size": 32, "intermediate_size": 64, "num_heads": 2, "out_hidden_size": 32,
                       "patch_size": 16, "deepstack_visual_indexes": [0], "num_position_embeddings": 64},
        image_token_id=vocabulary["<|image_pad|>"], video_token_id=vocabulary["<|video_pad|>"],
        vision_start_token_id=vocabulary["<|vision_start|>"], vision_end_token_id=vocabulary["<|vision_end|>"])
    Qwen3VLForConditionalGeneration(config).save_pretrained(folder)


def depth_anything(folder):
    """A Depth Anything on a DINOv2 of two layers, for images of 28 pixels."""
    import torch
    from transformers import DepthAnythingConfig, DepthAnythingForDepthEstimation, Dinov2Config, DPTImageProcessor

    torch.manual_seed(4)
    backbone = Dinov2Config(hidden_size=16, num_hidden_layers=4, num_attention_heads=2, image_size=28, patch_size=14,
                            out_indices=[1, 2, 3, 4], reshape_hidden_states=False, apply_layernorm=True)
    config = DepthAnythingConfig(backbone_config=backbone, reassemble_hidden_size=16, neck_hidden_sizes=[8, 8, 8, 8],
                                 fusion_hidden_size=8, head_hidden_size=4)
    DepthAnythingForDepthEstimation(config).save_pretrained(folder)
    DPTImageProcessor(size={"height": 56, "width": 56}, keep_aspect_ratio=True, ensure_multiple_of=14,
                      image_mean=[0.5] * 3, image_std=[0.5] * 3).save_pretrained(folder)


def other_depth(folder):
    """A network of depth that is not Depth Anything."""
    from transformers import DPTConfig, DPTForDepthEstimation

    config = DPTConfig(hidden_size=16, num_hidden_layers=4, num_attention_heads=2, intermediate_size=16, image_size=32,
                       backbone_out_indices=[0, 1, 2, 3], neck_hidden_sizes=[8, 8, 8, 8], fusion_hidden_size=8,
                       is_hybrid=False)
    DPTForDepthEstimation(config).save_pretrained(folder)
