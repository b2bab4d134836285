// A sensor_msgs/LaserScan as points. Pure.

const MOST_POINTS = 1500; // more than a screen shows, at 10 Hz

// Points in m in the scan's own frame, x and y in turn; what the sensor did not see (null, NaN, infinite, out of range)
// is left out.
export function scanPoints({ angle_min, angle_increment, range_min, range_max, ranges }) {
  const seen = within(range_min || 0, range_max > 0 ? range_max : Infinity);
  const step = Math.max(1, Math.ceil(ranges.length / MOST_POINTS));
  const points = [];
  for (let i = 0; i < ranges.length; i += step) {
    if (!seen(ranges[i])) continue;
    const angle = angle_min + i * angle_increment;
    points.push(ranges[i] * Math.cos(angle), ranges[i] * Math.sin(angle));
  }
  return Float32Array.from(points);
}

const within = (least, most) => (range) => Number.isFinite(range) && range >= least && range <= most;
