"""One file per segmenter: networks, and readers of finished label images. Imported only when used."""
