"""The classification of textures: protocols, splits, estimators and accuracies."""

#: The optional packages that a classification imports.
MODULES = ("pandas", "sklearn", "joblib", "cv2", "matplotlib")
