"""Logs of messages: decoding, choice of topics and times, whatever holds them."""
