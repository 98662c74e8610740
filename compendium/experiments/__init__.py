"""The experiments of chapter 5, one file a section: what takes many renders, seeds or fits."""
