"""The textbook's path with known lights: image -> normals and albedo -> gradients -> depth, and back.

Everything here is exact: three distant lights, a Lambertian surface, no noise. The script shows the conventions (x to the
right, y down, z towards the camera, depth positive where pressed), and that each step inverts another.
"""

import numpy as np

import gelform

MM_PER_PX = 0.05

# 1. A smooth bump, 0.4 mm high, and its slopes. z = depth, so the middle is high.
y, x = np.mgrid[:160, :200].astype(float)
x_mm, y_mm = (x - 100) * MM_PER_PX, (y - 80) * MM_PER_PX
depth_mm = 0.4 * np.exp(-(x_mm**2 + y_mm**2) / (2 * 1.2**2))
gradients = np.stack([-x_mm * depth_mm, -y_mm * depth_mm], axis=-1) / 1.2**2
assert gradients[80, 120, 0] < 0  # to the right of the middle the surface falls

# 2. What three lights make of it: red from the right, green from the lower left, blue from the upper left.
angles = np.radians([0, 120, 240])
lights = np.stack([0.6 * np.cos(angles), 0.6 * np.sin(angles), np.full(3, 0.8)], axis=-1)
normals = gelform.normals_from_gradients(gradients)
image = gelform.image_from_normals(normals, lights, albedo=180.0)

# 3. And back: normals and albedo from colors, slopes from normals, depth from slopes.
found_normals, albedo = gelform.normals_from_image(image, lights)
found_gradients = gelform.gradients_from_normals(found_normals)
found_mm = gelform.depth_from_gradients(found_gradients, mm_per_px=MM_PER_PX, zero="border")

print(f"albedo {albedo.mean():.3f} (180 put in), peak {found_mm.max():.4f} mm (0.4 put in)")
assert np.abs(albedo - 180).max() < 1e-3
assert np.abs(found_mm - depth_mm).max() < 1e-3  # mm: a thousandth of a millimeter
assert (
    np.abs(gelform.curl_from_gradients(found_gradients, mm_per_px=MM_PER_PX)).max() < 1e-2
)  # it is a surface
