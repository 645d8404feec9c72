"""How well an arm repeats poses and paths, by the indices of ISO 9283, with what is known of them.

`measures` has the formulas, `intervals` what the standard leaves out: how sure each figure is.
`holds` and `traverses` find repeated poses and paths in a session, `assess` judges them, `report`
words them. The forms are given from knowledge of the field, not from the printed standard.
"""
