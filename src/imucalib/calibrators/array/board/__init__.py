"""The rig: its drawing, streams, log and rests, before anything of its motion is fitted."""
