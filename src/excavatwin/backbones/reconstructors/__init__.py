"""One file per reconstructor: networks, and readers of finished reconstructions. Imported only when used."""
