"""What several equations share, written out in NumPy from the papers: nothing here is taken from the package."""

import numpy as np


def fresnel_transmittance(cosine, eta):
    """F_t from outside: one less the mean reflectance of both polarisations (Fresnel, Snell)."""
    cosine = np.asarray(cosine, float)
    inside = np.sqrt(1 - (1 - cosine**2) / eta**2)
    across = (cosine - eta * inside) / (cosine + eta * inside)
    along = (eta * cosine - inside) / (eta * cosine + inside)
    return 1 - (across**2 + along**2) / 2


def diffuse_transmittance(eta, count=20000):
    """T_d: the mean of F_t over the hemisphere, weighted by the cosine, by the midpoint rule."""
    cosine = (np.arange(count) + 0.5) / count
    return np.mean(2 * cosine * fresnel_transmittance(cosine, eta))


def diffuse_fresnel(eta):
    """F_dr as JB02 eq. 10 prints it."""
    return -1.440 / eta**2 + 0.710 / eta + 0.668 + 0.0636 * eta


def dipole_constants(sigma_s_prime, sigma_a, eta):
    """a', sigma_tr, z_r, z_v and A as the text after JB02 eq. 9 defines them."""
    sigma_t_prime = sigma_s_prime + sigma_a
    mean_free_path = 1 / sigma_t_prime
    mismatch = (1 + diffuse_fresnel(eta)) / (1 - diffuse_fresnel(eta))
    return (
        sigma_s_prime / sigma_t_prime,
        np.sqrt(3 * sigma_a * sigma_t_prime),
        mean_free_path,
        mean_free_path * (1 + 4 / 3 * mismatch),
        mismatch,
    )


def dipole(r, sigma_s_prime, sigma_a, eta):
    """R_d(r): JB02 eqs. 8 and 9."""
    albedo, sigma_tr, z_r, z_v, _ = dipole_constants(sigma_s_prime, sigma_a, eta)
    d_r, d_v = np.sqrt(r**2 + z_r**2), np.sqrt(r**2 + z_v**2)
    c_1, c_2 = z_r * (sigma_tr + 1 / d_r), z_v * (sigma_tr + 1 / d_v)
    return albedo / (4 * np.pi) * (c_1 * np.exp(-sigma_tr * d_r) / d_r**2 + c_2 * np.exp(-sigma_tr * d_v) / d_v**2)


def disk_integral(radius, sigma_s_prime, sigma_a, eta, count=20000):
    """The integral of R_d over a disk around a point of it, by the trapezoid rule."""
    r = np.concatenate([[0], np.geomspace(1e-4, 1, count)]) * radius
    return np.trapezoid(2 * np.pi * r * dipole(r, sigma_s_prime, sigma_a, eta), r)


def medium_of(medium, channel):
    """The coefficients of one channel of a `pellucid.Medium`, for the formulas above."""
    return float(medium.sigma_s_prime[channel]), float(medium.sigma_a[channel]), medium.eta
