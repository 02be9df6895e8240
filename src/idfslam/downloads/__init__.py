"""Public sequences fetched for the user: what there is, over HTTP with resuming, unpacked safely."""
