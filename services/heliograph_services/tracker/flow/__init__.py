"""Optical flow from onsets by the paper's network of delta-SNUs.

`network` states the equations and the parameters, `torch_net` defines the network in torch and exports it, `kernel`
runs what was exported, `intake` pools and gates, `readout` turns spikes into px/s, `pyramid` is what the tracker feeds
and asks, `surroundings` fits the motion of the whole view.
"""
