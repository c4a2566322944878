"""The parts of ``predict``: inputs on the axis, views of the scene, detection, uncertainty."""
