"""Policies that reached the best that is known of a preset's episodes: PRESET.safetensors with PRESET.json, its card.

They stay as they are when a policy that ships is trained anew, so that the published costs can be driven again.
"""
