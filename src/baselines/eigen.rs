//! Eigenvalues and eigenvectors of symmetric matrices, by Jacobi's method (Golub and Van Loan,
//! Matrix Computations, section 8.5).

use glam::{DMat3, DVec3};

/// Number of sweeps. Convergence is quadratic, so 12 sweeps are more than enough.
const SWEEPS: usize = 12;

/// The eigenvalues of a symmetric matrix, and its unit eigenvectors as the columns of a matrix, in
/// the same order.
pub fn symmetric_eigen(matrix: DMat3) -> (DVec3, DMat3) {
    let DMat3 { x_axis, y_axis, z_axis } = matrix;
    let mut columns = [x_axis, y_axis, z_axis];
    let mut vectors = DVec3::AXES;
    for _ in 0..SWEEPS {
        for [p, q] in [[0, 1], [0, 2], [1, 2]] {
            let off_diagonal = columns[p][q];
            if off_diagonal == 0.0 {
                continue;
            }
            // Compute the rotation in the plane of axes p and q that makes `off_diagonal` zero.
            let ratio = (columns[q][q] - columns[p][p]) / (2.0 * off_diagonal);
            let tangent = 1_f64.copysign(ratio) / (ratio.abs() + (ratio * ratio + 1.0).sqrt());
            let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
            let sine = tangent * cosine;
            for matrix in [&mut columns, &mut vectors] {
                let [a, b] = [matrix[p], matrix[q]];
                (matrix[p], matrix[q]) = (a * cosine - b * sine, a * sine + b * cosine);
            }
            for column in &mut columns {
                let [a, b] = [column[p], column[q]];
                (column[p], column[q]) = (a * cosine - b * sine, a * sine + b * cosine);
            }
            (columns[p][q], columns[q][p]) = (0.0, 0.0);
        }
    }
    let [x, y, z] = columns;
    let [a, b, c] = vectors;
    (DVec3::new(x.x, y.y, z.z), DMat3::from_cols(a, b, c))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvectors_are_orthonormal_and_scaled_by_their_eigenvalues() {
        let mut state = 1_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state) / f64::from(u32::MAX) - 0.5
        };
        for case in 0..200 {
            let random_matrix = DMat3::from_cols_array(&std::array::from_fn(|_| random()));
            // Some of the matrices have rank 1 or 2, or two equal eigenvalues.
            let scale =
                DMat3::from_diagonal([DVec3::ONE, DVec3::X, DVec3::new(1.0, 1.0, 0.0)][case % 3]);
            let matrix = random_matrix * scale * random_matrix.transpose();
            let matrix = if case % 5 == 0 {
                DMat3::from_diagonal(DVec3::new(2.0, 2.0, 1e-9))
            } else {
                matrix
            };
            let (values, vectors) = symmetric_eigen(matrix);
            assert!((vectors.transpose() * vectors).abs_diff_eq(DMat3::IDENTITY, 1e-14), "{case}");
            let scaled = vectors * DMat3::from_diagonal(values);
            assert!((matrix * vectors).abs_diff_eq(scaled, 1e-14), "{case}");
        }
    }
}
