"""How a cell's plugins meet on Zenoh, and who may say what there."""
