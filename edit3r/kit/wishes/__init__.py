"""Sentences read into wishes: the words that are known, and the reader."""
