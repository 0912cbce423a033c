"""The classical segmenter: superpixels, merging, salience and tracking, without learned weights."""
