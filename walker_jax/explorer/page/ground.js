// A pose as it is drawn: nothing of it passes through the ground, where the model lets it.

const SHORTEST = 0.9; // share of its length to which a swing leg is shortened; beyond, it is turned

/** The places of a pose, with the swing leg and a hip of some radius on or above the ground. */
export function aboveGround(places, { radius }, hipRadius) {
  const { swing, knee, angles } = places;
  const hip = [places.hip[0], Math.max(places.hip[1], hipRadius)];
  const down = hip[1] - radius; // of the foot's centre, where the sole touches the ground
  const leg = [swing[0] - hip[0], swing[1] - hip[1]];
  if (-leg[1] <= down) return { ...places, hip };
  const onGround = reachGround(leg, Math.max(0, down));
  const turn = Math.atan2(leg[0] * onGround[1] - leg[1] * onGround[0], leg[0] * onGround[0] + leg[1] * onGround[1]);
  const size = Math.hypot(...onGround) / Math.hypot(...leg);
  const moved = ([x, y]) => {
    const [u, v] = [x - hip[0], y - hip[1]].map((part) => size * part);
    const [cos, sin] = [Math.cos(turn), Math.sin(turn)];
    return [hip[0] + cos * u - sin * v, Math.max(0, hip[1] + sin * u + cos * v)];
  };
  return { ...places, hip, swing: moved(swing), knee: knee && moved(knee), angles: [angles[0], angles[1] + turn] };
}

/** The leg, from the hip, shortened until it ends so far below the hip; if that is much, turned outwards too. */
function reachGround([x, y], down) {
  const share = down / -y;
  if (share >= SHORTEST) return [share * x, -down];
  const length = SHORTEST * Math.hypot(x, y);
  return [Math.sign(x || 1) * Math.sqrt(Math.max(0, length ** 2 - down ** 2)), -down];
}
