"""Pairs through the model, one after the other, collated."""

import torch


def _collated(items):
    if isinstance(items[0], dict):
        return {key: _collated([item[key] for item in items]) for key in items[0]}
    return torch.cat(items) if isinstance(items[0], torch.Tensor) else list(items)


@torch.no_grad()
def inference(pairs, model, device, batch_size=8, verbose=True):
    """``view1``, ``view2``, ``pred1``, ``pred2`` of all pairs."""
    assert not verbose
    seen = []
    for view1, view2 in pairs:
        views = [{**view, "true_shape": torch.from_numpy(view["true_shape"])} for view in (view1, view2)]
        pred1, pred2 = model(*views)
        seen.append({"view1": views[0], "view2": views[1], "pred1": pred1, "pred2": pred2})
    return _collated(seen)
