"""Table VI, network modules: without the embedding of position, of time, of both.

python benchmarks/paper/table6_embeddings.py --budget 1 --save
"""

from lab import Variant, run

NO_POSITION = {"position_frequencies": 0}
NO_TIME = {"time_frequencies": 0, "film": []}
NOTE = (
    "Without P-Emb the network sees x alone; without T-Emb there is neither embedding nor FiLM, so "
    "that the field does not know its time."
)
VARIANTS = [
    Variant("default", {}, paper=("1.913", "99.99", "98.57", "97.79")),
    Variant("w/o P-Emb", {"network": NO_POSITION}, paper=("1.957", "99.85", "98.34", "94.54")),
    Variant("w/o T-Emb", {"network": NO_TIME}, paper=("1.946", "99.91", "98.48", "96.08")),
    Variant(
        "w/o both", {"network": NO_POSITION | NO_TIME}, paper=("2.019", "99.73", "97.62", "94.12")
    ),
]

if __name__ == "__main__":
    run("paper_table6_embeddings", "Table VI: embeddings", NOTE, VARIANTS)
