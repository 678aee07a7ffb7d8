"""The generalised cosine lobes of Lobelia (4.1)-(4.4) as a BSDF of Mitsuba 3, written apart from the Rust code.

Vectorised variants only: a scalar variant would call Python for every sample.
"""

import json
import math

import drjit as dr
import mitsuba as mi

LUMINANCE = (0.2126, 0.7152, 0.0722)


class Lafortune(mi.BSDF):
    """rho_d + sum of rho_s (wi . C' wo)^n; both sides of a surface reflect alike."""

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        spec = json.loads(props["spec"])
        self.rho_d = mi.Color3f(spec["rho_d"])
        self.diffuse = math.pi * sum(w * x for w, x in zip(LUMINANCE, spec["rho_d"]))
        cos, sin = math.cos(spec["beta"]), math.sin(spec["beta"])
        self.lobes = []
        for lobe in spec["lobes"]:
            cx, cy, cz = lobe["c"]
            matrix = (cx * cos**2 + cy * sin**2, (cx - cy) * cos * sin, cx * sin**2 + cy * cos**2, cz)
            weight = sum(w * x for w, x in zip(LUMINANCE, lobe["rho_s"]))
            self.lobes.append((mi.Color3f(lobe["rho_s"]), weight, matrix, lobe["n"]))
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_flags = flags
        self.m_components = [flags]

    def _aim(self, view):
        """Peak, length of the peak and share of the samples of every lobe, and the share of the diffuse term."""
        peaks, total = [], mi.Float(self.diffuse)
        for _, weight, (xx, xy, yy, zz), n in self.lobes:
            peak = mi.Vector3f(xx * view.x + xy * view.y, xy * view.x + yy * view.y, zz * view.z)
            length = dr.maximum(dr.norm(peak), 1e-8)
            estimate = weight * dr.power(length, n) * 2 * dr.pi / (n + 1) * dr.maximum(peak.z / length, 0.05)
            peaks.append((peak / length, length, estimate))
            total += estimate
        scale = dr.select(total > 0, 0.9 / total, 0)
        peaks = [(peak, length, estimate * scale) for peak, length, estimate in peaks]
        return peaks, 1 - sum((share for _, _, share in peaks), mi.Float(0))

    def _evaluate(self, peaks, diffuse, wi):
        """f cos(theta) and the density of the mixture."""
        value, density = mi.Color3f(self.rho_d), diffuse * wi.z * dr.inv_pi
        for (rho_s, _, _, n), (peak, length, share) in zip(self.lobes, peaks):
            cosine = dr.maximum(dr.dot(peak, wi), 0)
            power = dr.select(cosine > 0, dr.power(cosine, n), 0)
            value += rho_s * power * dr.power(length, n)
            density += share * power * (n + 1) / (2 * dr.pi)
        return value * wi.z, density

    @staticmethod
    def _above(direction, side):
        return mi.Vector3f(direction.x, direction.y, direction.z * side)

    def sample(self, ctx, si, sample1, sample2, active):
        side = dr.sign(si.wi.z)
        peaks, diffuse = self._aim(self._above(si.wi, side))
        wi = mi.warp.square_to_cosine_hemisphere(sample2)
        sin, cos = dr.sincos(2 * dr.pi * sample2.x)
        low = mi.Float(0)
        for (_, _, _, n), (peak, _, share) in zip(self.lobes, peaks):
            z = dr.power(dr.maximum(1 - sample2.y, 1e-30), 1 / (n + 1))
            radius = dr.safe_sqrt(1 - z * z)
            direction = mi.Frame3f(peak).to_world(mi.Vector3f(radius * cos, radius * sin, z))
            wi = dr.select((sample1 >= low) & (sample1 < low + share), direction, wi)
            low += share
        active &= wi.z > 0
        value, density = self._evaluate(peaks, diffuse, wi)
        result = mi.BSDFSample3f(self._above(wi, side))
        result.pdf = dr.select(active, density, 0)
        result.eta = 1.0
        result.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
        result.sampled_component = mi.UInt32(0)
        return result, dr.select(active & (density > 0), value / density, 0)

    def eval_pdf(self, ctx, si, wo, active):
        side = dr.sign(si.wi.z)
        wi = self._above(wo, side)
        active &= wi.z > 0
        value, density = self._evaluate(*self._aim(self._above(si.wi, side)), wi)
        return dr.select(active, value, 0), dr.select(active, density, 0)

    def eval(self, ctx, si, wo, active):
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active):
        return self.eval_pdf(ctx, si, wo, active)[1]

    def traverse(self, callback):
        pass

    def parameters_changed(self, keys):
        pass

    def to_string(self):
        return f"Lafortune[{len(self.lobes)} lobes]"


def register():
    mi.register_bsdf("lafortune", Lafortune)
