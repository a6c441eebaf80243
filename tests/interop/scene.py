"""A street of textured boxes, seen by a stereo camera and a LiDAR: ray casting with numpy, nothing of calibd's."""

import numpy as np

WIDTH, HEIGHT, FOCAL, BASELINE_M = 840, 280, 500.0, 0.5
INTRINSICS = [FOCAL, FOCAL, WIDTH / 2, 0.65 * HEIGHT]

# The LiDAR looks along x with z up; the camera along z with y down. A little off, as mounted sensors are.
AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
LIDAR_IN_CAMERA = np.array([0.05, -0.08, -0.1])


def rotation(roll, pitch, yaw):
    """Rx Ry Rz, degrees."""
    a, b, c = np.radians([roll, pitch, yaw])
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return x @ y @ z


def quaternion_xyzw(R):
    w = np.sqrt(max(0, 1 + np.trace(R))) / 2
    return np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 4 * w * w]) / (4 * w)


def rotation_of(xyzw):
    x, y, z, w = xyzw
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


R_CAMERA_LIDAR = AXES @ rotation(0.4, -0.3, 0.5)


def angle_deg(R):
    return np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)))


class Street:
    """Ground 1.6 m below the camera, walls at either side, boxes between; repeats every 60 m."""

    LENGTH = 60.0

    def __init__(self, seed=3):
        random = np.random.default_rng(seed)
        boxes = []
        for i in range(45):  # poles, bushes, cars, booths; none nearer than stereo reaches
            side = random.choice([-1, 1])
            width, height, length = random.uniform([0.3, 0.8, 0.3], [1.6, 4.5, 2.5])
            near = side * random.uniform(2.4, 6)
            x = (near, near + side * width)
            z = 60 / 45 * i + random.uniform(0, 1)
            bottom = 1.6 - (random.uniform(0, 1.5) if i % 3 == 0 else 0)  # some are signs, above the ground
            boxes.append((min(x), max(x), bottom - height, bottom, z, z + length))
        for i in range(6):  # the walls step in and out
            for side in (-1, 1):
                x = side * random.uniform(6, 9)
                boxes.append((min(x, 12 * side), max(x, 12 * side), 1.6 - random.uniform(8, 14), 1.6, 10 * i, 10 * i + 10))
        self._boxes = np.array(boxes)
        directions = random.normal(size=(8, 3))
        self._directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        self._phases = random.uniform(0, 2 * np.pi, 8)

    def _cast(self, origin, rays):
        """Distance along each ray (infinite for the sky)."""
        inverse = 1 / np.where(np.abs(rays) < 1e-9, 1e-9, rays)
        distance = np.where(rays[:, 1] > 1e-6, (1.6 - origin[1]) * inverse[:, 1], np.inf)
        for lap in (0, 1):
            for x0, x1, y0, y1, z0, z1 in self._boxes + np.array([0, 0, 0, 0, 1, 1]) * (lap * self.LENGTH):
                if z1 < origin[2] or z0 > origin[2] + 55:
                    continue
                low = (np.array([x0, y0, z0]) - origin) * inverse
                high = (np.array([x1, y1, z1]) - origin) * inverse
                enter, leave = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
                hit = (enter < leave) & (enter > 0.3)
                distance = np.where(hit & (enter < distance), enter, distance)
        return np.where(distance < 60, distance, np.inf)

    def _noise(self, points, wavelength):
        """Smooth, about -1 .. 1: waves of this length in many directions, so that no two places look the same."""
        phase = points @ (self._directions.T * (2 * np.pi / wavelength)) + self._phases
        return np.sin(phase).sum(axis=1) / 2.5

    def _texture(self, points, distance):
        """Grey from waves of four lengths (metres), the short ones only where pixels can show them."""
        grey = np.full(len(points), 115.0)
        for wavelength in (0.1, 0.3, 0.9, 2.7):
            grey += 28 * np.clip(wavelength * FOCAL / distance / 3 - 1, 0, 1) * self._noise(points, wavelength)
        return grey

    def image(self, origin):
        u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        rays = np.stack([(u - INTRINSICS[2]) / FOCAL, (v - INTRINSICS[3]) / FOCAL, np.ones_like(u)], -1).reshape(-1, 3)
        distance = self._cast(origin, rays)
        seen = np.isfinite(distance)
        # Clouds, infinitely far: matched at no disparity, where a plain sky would take that of the roofs before it.
        grey = 185 + 20 * self._noise(rays, 0.03) + 20 * self._noise(rays, 0.11)
        grey[seen] = self._texture(origin + distance[seen, None] * rays[seen], distance[seen])
        return np.clip(grey, 0, 255).astype(np.uint8).reshape(HEIGHT, WIDTH)

    def scan(self, origin):
        """Points in the LiDAR frame, float32 x y z intensity."""
        elevation, azimuth = np.meshgrid(np.radians(np.linspace(-18, 8, 48)), np.radians(np.arange(-50, 50, 0.3)))
        beams = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)],
                         -1).reshape(-1, 3)
        distance = self._cast(origin + LIDAR_IN_CAMERA, beams @ R_CAMERA_LIDAR.T)
        points = beams[np.isfinite(distance)] * distance[np.isfinite(distance), None]
        return np.hstack([points, np.full((len(points), 1), 0.3)]).astype(np.float32)

    def frame(self, forward_m):
        """Left image, right image and scan from a place on the street."""
        origin = np.array([0, 0, forward_m % self.LENGTH])
        return self.image(origin), self.image(origin + [BASELINE_M, 0, 0]), self.scan(origin)


def knocked(points, roll, pitch, yaw):
    """The scan of a LiDAR that was turned by these degrees about its own axes."""
    turned = points.copy()
    turned[:, :3] = points[:, :3] @ rotation(roll, pitch, yaw)  # inverse rotation of each point
    return turned
