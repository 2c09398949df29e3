"""The paper's study again: Y. Chen and B. Zhang, arXiv 2507.06416, with what they report beside what comes out here."""
