/* Stages of a device under one grip, for a tap that is solved alone: its exact hold, scaled states, modal coordinates, and
 * the cost of the time after the window. The same numbers as those of `discretise`, `linear_stage`, `modes_of` and `tails`
 * in Python, for one plant with an amplifier and without a wall. All matrices are row by row.
 */
#include <float.h>
#include <math.h>
#include <string.h>

#include "device.h"

enum { MOST = TR_MOST_DEVICE, MOST_SWEEPS = 100, MOST_STEPS = 60, HALF_PERIOD = 20, MOST_PERIODS = 20, LANES = 4 };

/* Of the diagonal Pade approximant of degree 13 (Higham 2005), as in `transopt.base.matrices`. */
static const double PADE[] = {64764752532480000.0, 32382376266240000.0, 7771770303897600.0, 1187353796428800.0,
                              129060195264000.0,   10559470521600.0,    670442572800.0,     33522128640.0,
                              1323241920.0,        40840800.0,          960960.0,           16380.0,
                              182.0,               1.0};
static const double LARGEST_NORM = 5.371920351148152, BALANCED = 0.95, VANISHED = 1e-150;
static const double LEFT_OUT = 1e-10; /* largest entry of A that is zero in exact modal coordinates */

static void multiplied(int n, const double *a, const double *b, double *found)
{
    memset(found, 0, (size_t)(n * n) * sizeof(double));
    for (int i = 0; i < n; i++)
        for (int l = 0; l < n; l++)
            for (int j = 0; j < n; j++) found[i * n + j] += a[i * n + l] * b[l * n + j];
}

/* Solve a x = b in place of b (n, columns), with partial pivoting; a is overwritten. Returns 0 if a is singular. */
static int solved(int n, int columns, double *a, double *b)
{
    for (int k = 0; k < n; k++) {
        int at = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[at * n + k])) at = i;
        if (!(fabs(a[at * n + k]) > 0.0)) return 0;
        for (int j = 0; at != k && j < n; j++) {
            const double held = a[k * n + j];
            a[k * n + j] = a[at * n + j], a[at * n + j] = held;
        }
        for (int j = 0; at != k && j < columns; j++) {
            const double held = b[k * columns + j];
            b[k * columns + j] = b[at * columns + j], b[at * columns + j] = held;
        }
        for (int i = k + 1; i < n; i++) {
            const double by = a[i * n + k] / a[k * n + k];
            for (int j = k + 1; j < n; j++) a[i * n + j] -= by * a[k * n + j];
            for (int j = 0; j < columns; j++) b[i * columns + j] -= by * b[k * columns + j];
        }
    }
    for (int i = n - 1; i >= 0; i--)
        for (int j = 0; j < columns; j++) {
            for (int l = i + 1; l < n; l++) b[i * columns + j] -= a[i * n + l] * b[l * columns + j];
            b[i * columns + j] /= a[i * n + i];
        }
    return 1;
}

/* Powers of two that make row and column norms of a nearly equal; a becomes S^-1 a S. */
static void balance(int n, double *a, double *scale)
{
    for (int i = 0; i < n; i++) scale[i] = 1.0;
    for (int sweep = 0, settled = 0; sweep < MOST_SWEEPS && !settled; sweep++) {
        settled = 1;
        for (int i = 0; i < n; i++) {
            double column = 0.0, row = 0.0;
            for (int j = 0; j < n; j++) column = hypot(column, a[j * n + i]), row = hypot(row, a[i * n + j]);
            if (!(column > 0.0 && column < INFINITY && row > 0.0 && row < INFINITY)) continue;
            const double by = exp2(nearbyint(0.5 * (log2(row) - log2(column))));
            if (!(column * by + row / by < BALANCED * (column + row))) continue;
            for (int j = 0; j < n; j++) a[j * n + i] *= by;
            for (int j = 0; j < n; j++) a[i * n + j] /= by;
            scale[i] *= by, settled = 0;
        }
    }
}

/* exp(a) in place of a, by scaling and squaring. Returns 0 if it is not finite. */
static int exponential(int n, double *a)
{
    double scale[MOST], A2[MOST * MOST], A4[MOST * MOST], A6[MOST * MOST], odd[MOST * MOST], even[MOST * MOST];
    double of[MOST * MOST] = {0}, norm = 0.0;
    const double *b = PADE;
    balance(n, a, scale);
    for (int j = 0; j < n; j++) {
        double column = 0.0;
        for (int i = 0; i < n; i++) column += fabs(a[i * n + j]);
        norm = column <= norm ? norm : column;
    }
    if (!(norm < INFINITY)) return 0;
    const int squarings = norm > LARGEST_NORM ? (int)ceil(log2(norm / LARGEST_NORM)) : 0;
    for (int i = 0; i < n * n; i++) a[i] = ldexp(a[i], -squarings);
    multiplied(n, a, a, A2), multiplied(n, A2, A2, A4), multiplied(n, A4, A2, A6);
    for (int i = 0; i < n * n; i++) of[i] = b[13] * A6[i] + b[11] * A4[i] + b[9] * A2[i];
    multiplied(n, A6, of, odd);
    for (int i = 0; i < n * n; i++)
        odd[i] += b[7] * A6[i] + b[5] * A4[i] + b[3] * A2[i] + (i % (n + 1) ? 0.0 : b[1]);
    multiplied(n, a, odd, of);
    memcpy(odd, of, (size_t)(n * n) * sizeof(double));
    for (int i = 0; i < n * n; i++) of[i] = b[12] * A6[i] + b[10] * A4[i] + b[8] * A2[i];
    multiplied(n, A6, of, even);
    for (int i = 0; i < n * n; i++)
        even[i] += b[6] * A6[i] + b[4] * A4[i] + b[2] * A2[i] + (i % (n + 1) ? 0.0 : b[0]);
    for (int i = 0; i < n * n; i++) a[i] = even[i] + odd[i], even[i] -= odd[i];
    if (!solved(n, n, even, a)) return 0;
    for (int k = 0; k < squarings; k++) {
        multiplied(n, a, a, of);
        memcpy(a, of, (size_t)(n * n) * sizeof(double));
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) a[i * n + j] *= scale[i] / scale[j];
    return 1;
}

/* Sizes of the states under a square wave of the command, as `plant.scaling`; 1 for a state that it does not move. */
static void sizes(int n, int stages, const double *A, double *found)
{
    double x[MOST] = {0}, next[MOST], across[MOST * MOST];
    const int states = n - 1, longest = HALF_PERIOD * MOST_PERIODS;
    const int halves = ((stages < longest ? stages : longest) + HALF_PERIOD - 1) / HALF_PERIOD;
    for (int i = 0; i < n; i++) found[i] = 0.0;
    for (int i = 0; i < states; i++)
        for (int j = 0; j < n; j++) across[j * states + i] = A[i * n + j];
    for (int k = 0; k < halves * HALF_PERIOD; k++) {
        const double command = k / HALF_PERIOD % 2 ? -1.0 : 1.0;
        for (int i = 0; i < states; i++) next[i] = command * across[states * states + i];
        for (int j = 0; j < states; j++)
            for (int i = 0; i < states; i++) next[i] += across[j * states + i] * x[j];
        for (int i = 0; i < states; i++) {
            x[i] = next[i];
            found[i] = fabs(x[i]) > found[i] ? fabs(x[i]) : found[i];
        }
    }
    for (int i = 0; i < n; i++) found[i] = found[i] > 0.0 ? found[i] : 1.0;
}

static int states_of(const tr_device *d)
{
    int n = d->plant + 2;
    for (int t = 0; t < d->terms; t++) n += d->filter[t * TR_FILTER] != 0.0 ? 2 : 0;
    return n;
}

/* A (n, n) and C (terms, n) of the scaled states: plant, current, error filters, held command. Returns n; 0 where there
 * are too many states, or a number is not finite. */
static int scaled(const tr_device *d, double *A, double *C)
{
    double hold[MOST * MOST], size[MOST], made[MOST];
    const int p = d->plant, n = states_of(d), held = p + 2;
    if (n > MOST) return 0;
    memcpy(hold, d->flow, (size_t)(held * held) * sizeof(double));
    if (!exponential(held, hold)) return 0;
    memset(A, 0, (size_t)(n * n) * sizeof(double));
    memset(C, 0, (size_t)(d->terms * n) * sizeof(double));
    for (int i = 0; i <= p; i++) {
        for (int j = 0; j <= p; j++) A[i * n + j] = hold[i * held + j];
        A[i * n + n - 1] = hold[i * held + p + 1], made[i] = d->output[i];
    }
    A[n * n - 1] = 1.0;
    for (int t = 0, at = p + 1; t < d->terms; t++) {
        const double *filter = d->filter + t * TR_FILTER;
        const int filtered = filter[0] != 0.0;
        for (int i = 0; i <= p; i++) C[t * n + i] = (filtered ? filter[3] : 1.0) * made[i];
        if (!filtered) continue;
        memcpy(A + at * n, made, (size_t)(p + 1) * sizeof(double));
        A[at * n + at] = -filter[1], A[at * n + at + 1] = -filter[2], A[(at + 1) * n + at] = 1.0;
        C[t * n + at] = filter[4], C[t * n + at + 1] = filter[5];
        at += 2;
    }
    sizes(n, d->stages, A, size);
    size[p] = 1.0;
    int finite = 1;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) A[i * n + j] *= size[j] / size[i], finite &= fabs(A[i * n + j]) < INFINITY;
    for (int i = 0; i < d->terms * n; i++) C[i] *= size[i % n], finite &= fabs(C[i]) < INFINITY;
    return finite ? n : 0;
}

/* Sum of products, in lanes that the compiler may work on side by side. */
static double product(int count, const double *a, const double *b)
{
    double sums[LANES] = {0}, rest = 0.0;
    int k = 0;
    for (; k + LANES <= count; k += LANES)
        for (int l = 0; l < LANES; l++) sums[l] += a[k + l] * b[k + l];
    for (; k < count; k++) rest += a[k] * b[k];
    return sums[0] + sums[1] + (sums[2] + sums[3]) + rest;
}

/* sqrt of the product of 1-norm and infinity-norm, at least the 2-norm. */
static double bounded(int n, const double *a)
{
    double columns = 0.0, rows = 0.0;
    for (int i = 0; i < n; i++) {
        double row = 0.0, column = 0.0;
        for (int j = 0; j < n; j++) row += fabs(a[i * n + j]), column += fabs(a[j * n + i]);
        rows = row <= rows ? rows : row, columns = column <= columns ? columns : column;
    }
    return sqrt(rows * columns);
}

/* Upper Hessenberg form of a (n, n) in place, by elimination with pivoting (EISPACK elmhes). */
static void hessenberg(int n, double *a)
{
    for (int m = 1; m < n - 1; m++) {
        int at = m;
        for (int i = m + 1; i < n; i++)
            if (fabs(a[i * n + m - 1]) > fabs(a[at * n + m - 1])) at = i;
        const double pivot = a[at * n + m - 1];
        for (int j = m - 1; at != m && j < n; j++) {
            const double held = a[at * n + j];
            a[at * n + j] = a[m * n + j], a[m * n + j] = held;
        }
        for (int i = 0; at != m && i < n; i++) {
            const double held = a[i * n + at];
            a[i * n + at] = a[i * n + m], a[i * n + m] = held;
        }
        for (int i = m + 1; pivot != 0.0 && i < n; i++) {
            const double by = a[i * n + m - 1] / pivot;
            a[i * n + m - 1] = 0.0;
            for (int j = m; j < n; j++) a[i * n + j] -= by * a[m * n + j];
            for (int j = 0; j < n; j++) a[j * n + m] += by * a[j * n + i];
        }
    }
}

/* One of Francis' double QR steps on the rows and columns first..last of a Hessenberg matrix, with the shifts' sum and
 * product; it starts at the row at which two small subdiagonal entries follow each other. */
static void francis(int n, double *a, int first, int last, double sum, double product_of_both)
{
    double p = 0.0, q = 0.0, r = 0.0;
    int from = last - 2;
    for (; from >= first; from--) {
        const double *row = a + from * n + from, *next = row + n;
        p = row[0] * (row[0] - sum) + product_of_both + row[1] * next[0];
        q = next[0] * (row[0] + next[1] - sum), r = next[0] * next[n + 1];
        const double size = fabs(p) + fabs(q) + fabs(r);
        p /= size, q /= size, r /= size;
        if (from == first) break;
        const double around = fabs(row[-n - 1]) + fabs(row[0]) + fabs(next[1]);
        if (fabs(row[-1]) * (fabs(q) + fabs(r)) <= DBL_EPSILON * fabs(p) * around) break;
    }
    for (int k = from; k < last; k++) {
        const int three = k < last - 1;
        double size = 1.0;
        if (k > from) {
            p = a[k * n + k - 1], q = a[(k + 1) * n + k - 1], r = three ? a[(k + 2) * n + k - 1] : 0.0;
            size = fabs(p) + fabs(q) + fabs(r);
            if (size == 0.0) continue;
            p /= size, q /= size, r /= size;
        }
        const double along = copysign(sqrt(p * p + q * q + r * r), p);
        if (k > from) {
            a[k * n + k - 1] = -along * size, a[(k + 1) * n + k - 1] = 0.0;
            if (three) a[(k + 2) * n + k - 1] = 0.0;
        } else if (from > first) {
            a[k * n + k - 1] = -a[k * n + k - 1];
        }
        const double x = (p + along) / along, y = q / along, z = r / along, by = q / (p + along), by_z = r / (p + along);
        for (int j = k; j < n; j++) {
            const double t = a[k * n + j] + by * a[(k + 1) * n + j] + (three ? by_z * a[(k + 2) * n + j] : 0.0);
            a[k * n + j] -= t * x, a[(k + 1) * n + j] -= t * y;
            if (three) a[(k + 2) * n + j] -= t * z;
        }
        for (int i = 0; i <= (k + 3 < last ? k + 3 : last); i++) {
            const double t = x * a[i * n + k] + y * a[i * n + k + 1] + (three ? z * a[i * n + k + 2] : 0.0);
            a[i * n + k] -= t, a[i * n + k + 1] -= t * by;
            if (three) a[i * n + k + 2] -= t * by_z;
        }
    }
}

/* Eigenvalues (n, 2), real and imaginary part, of a (n, n), which is overwritten. Returns 0 if they do not converge. */
static int eigenvalues(int n, double *a, double *values)
{
    hessenberg(n, a);
    for (int last = n - 1, steps = 0; last >= 0;) {
        int first = last;
        for (; first > 0; first--) {
            const double beside = fabs(a[(first - 1) * n + first - 1]) + fabs(a[first * n + first]);
            if (fabs(a[first * n + first - 1]) <= DBL_EPSILON * beside) break;
        }
        const double corner = a[last * n + last];
        if (first == last) {
            values[2 * last] = corner, values[2 * last + 1] = 0.0;
            last--, steps = 0;
            continue;
        }
        const double before = a[(last - 1) * n + last - 1], cross = a[last * n + last - 1] * a[(last - 1) * n + last];
        if (first == last - 1) {
            const double half = 0.5 * (before - corner), square = half * half + cross, root = sqrt(fabs(square));
            const double far = half + copysign(root, half);
            double *two = values + 2 * (last - 1);
            if (square >= 0.0)
                two[0] = corner + far, two[2] = far != 0.0 ? corner - cross / far : corner, two[1] = two[3] = 0.0;
            else
                two[0] = two[2] = corner + half, two[1] = root, two[3] = -root;
            last -= 2, steps = 0;
            continue;
        }
        if (steps == MOST_STEPS) return 0;
        /* Now and then other shifts, for matrices on which the usual ones turn in circles. */
        const double off = fabs(a[last * n + last - 1]) + fabs(a[(last - 1) * n + last - 2]);
        if (++steps % 10)
            francis(n, a, first, last, corner + before, corner * before - cross);
        else
            francis(n, a, first, last, 2.0 * corner + 1.5 * off, corner * (corner + 1.5 * off) + off * off);
    }
    return 1;
}

/* The size of a complex number, up to a factor of sqrt(2). */
static double size_of(const double *z) { return fabs(z[0]) + fabs(z[1]); }

/* z -= x y, of complex numbers. */
static void less(double *z, const double *x, const double *y)
{
    z[0] -= x[0] * y[0] - x[1] * y[1], z[1] -= x[0] * y[1] + x[1] * y[0];
}

/* z = x / y, of complex numbers; z may be x. */
static void divided(double *z, const double *x, const double *y)
{
    const double square = y[0] * y[0] + y[1] * y[1], real = (x[0] * y[0] + x[1] * y[1]) / square;
    z[1] = (x[1] * y[0] - x[0] * y[1]) / square, z[0] = real;
}

/* Eigenvector (n, 2) of a (n, n) for an eigenvalue that is known up to rounding, by two steps of inverse iteration. */
static void eigenvector(int n, const double *a, const double *value, double *found)
{
    double of[2 * MOST * MOST], size = 0.0;
    int chosen[MOST];
    for (int i = 0; i < n * n; i++) of[2 * i] = a[i], of[2 * i + 1] = 0.0, size = fmax(size, fabs(a[i]));
    for (int i = 0; i < n; i++) {
        of[2 * i * (n + 1)] -= value[0], of[2 * i * (n + 1) + 1] -= value[1];
        found[2 * i] = 1.0, found[2 * i + 1] = 0.0;
    }
    for (int k = 0; k < n; k++) {
        double *row = of + 2 * k * n, *pivot = row + 2 * k;
        int at = k;
        for (int i = k + 1; i < n; i++)
            if (size_of(of + 2 * (i * n + k)) > size_of(of + 2 * (at * n + k))) at = i;
        chosen[k] = at;
        for (int j = 0; at != k && j < 2 * n; j++) {
            const double held = row[j];
            row[j] = of[2 * at * n + j], of[2 * at * n + j] = held;
        }
        /* The matrix is singular up to rounding, by which the vector grows along the one sought. */
        if (size_of(pivot) < DBL_EPSILON * size) pivot[0] = DBL_EPSILON * size, pivot[1] = 0.0;
        for (int i = k + 1; i < n; i++) {
            double *other = of + 2 * i * n, *by = other + 2 * k;
            divided(by, by, pivot);
            for (int j = k + 1; j < n; j++) less(other + 2 * j, by, row + 2 * j);
        }
    }
    /* The first step starts behind the elimination, from ones. */
    for (int step = 0; step < 2; step++) {
        double largest = 0.0;
        for (int k = 0; step && k < n; k++) {
            double *own = found + 2 * k, *other = found + 2 * chosen[k];
            const double real = own[0], imaginary = own[1];
            own[0] = other[0], own[1] = other[1], other[0] = real, other[1] = imaginary;
        }
        for (int k = 0; step && k < n; k++)
            for (int i = k + 1; i < n; i++) less(found + 2 * i, of + 2 * (i * n + k), found + 2 * k);
        for (int i = n - 1; i >= 0; i--) {
            for (int j = i + 1; j < n; j++) less(found + 2 * i, of + 2 * (i * n + j), found + 2 * j);
            divided(found + 2 * i, found + 2 * i, of + 2 * i * (n + 1));
            largest = fmax(largest, size_of(found + 2 * i));
        }
        for (int i = 0; i < 2 * n; i++) found[i] /= largest;
    }
}

/* Columns of T from the eigenvectors of A without its last row and column: complex modes in pairs, then real ones, the
 * current's last, then the held command. Returns the number of columns in pairs, or -1 where the current is no mode. */
static int columns_of(int n, int current, const double *values, const double *vectors, double *T)
{
    const int m = n - 1;
    int at = 0, own = -1;
    memset(T, 0, (size_t)(n * n) * sizeof(double));
    for (int j = 0; j < m; j++) {
        double real = 0.0, imaginary = 0.0;
        if (!(values[2 * j + 1] > 0.0)) continue;
        if (at + 2 > m) return -1;
        for (int i = 0; i < m; i++) {
            const double *v = vectors + 2 * (j * m + i);
            real += v[0] * v[0] - v[1] * v[1], imaginary += 2.0 * v[0] * v[1];
        }
        /* The phase for which real and imaginary part are orthogonal. */
        const double half = 0.5 * atan2(imaginary, real), c = cos(half), s = sin(half);
        for (int i = 0; i < m; i++) {
            const double *v = vectors + 2 * (j * m + i);
            T[i * n + at] = v[0] * c + v[1] * s, T[i * n + at + 1] = v[1] * c - v[0] * s;
        }
        at += 2;
    }
    const int pairs = at;
    for (int j = 0; j < m; j++)
        if (values[2 * j + 1] == 0.0 &&
            (own < 0 || fabs(vectors[2 * (j * m + current)]) > fabs(vectors[2 * (own * m + current)])))
            own = j;
    if (own < 0) return -1;
    for (int j = 0; j < m; j++) {
        if (values[2 * j + 1] != 0.0 || j == own) continue;
        for (int i = 0; i < m; i++) T[i * n + at] = vectors[2 * (j * m + i)];
        at++;
    }
    if (at != m - 1) return -1;
    for (int i = 0; i < m; i++) T[i * n + at] = vectors[2 * (own * m + i)];
    T[n * n - 1] = 1.0;
    for (int j = 0; j < m; j++) {
        double square = 0.0;
        for (int i = 0; i < m; i++) square += T[i * n + j] * T[i * n + j];
        /* The current keeps its unit. */
        const double by = j == at ? T[current * n + at] : sqrt(square);
        for (int i = 0; i < m; i++) T[i * n + j] /= by;
    }
    for (int j = 0; j < n; j++) T[current * n + j] = j == at ? 1.0 : 0.0;
    return pairs;
}

/* Factor the outputs after the window: |O z - asked|^2 = |gain z - target|^2 + rest, O of `rows` rows, by Householder's
 * reflections. `work` holds the columns of O one after the other, and then `asked`. */
static double reduced(int rows, int n, double *work, double *gain, double *target)
{
    double *asked = work + (size_t)n * (size_t)rows;
    for (int j = 0; j < n && j < rows; j++) {
        double *column = work + (size_t)j * (size_t)rows;
        const int left = rows - j;
        const double size = sqrt(product(left, column + j, column + j)), along = column[j] > 0.0 ? -size : size;
        const double square = size * (size + fabs(column[j]));
        if (!(square > 0.0)) continue;
        column[j] -= along;
        for (int l = j + 1; l <= n; l++) {
            double *other = work + (size_t)l * (size_t)rows;
            const double by = product(left, column + j, other + j) / square;
            for (int k = j; k < rows; k++) other[k] -= by * column[k];
        }
        column[j] = along;
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) gain[i * n + j] = i <= j && i < rows ? work[(size_t)j * (size_t)rows + i] : 0.0;
        target[i] = i < rows ? asked[i] : 0.0;
    }
    return rows > n ? product(rows - n, asked + n, asked + n) : 0.0;
}

/* The modal coordinates z of the states, x = T z, and A in them. Returns a bound of the condition of T, infinite where A
 * has no such coordinates; `pairs` is the number of states in pairs. */
static double modal(int n, int current, const double *A, double *T, double *found, int *pairs)
{
    double values[2 * MOST], vectors[2 * MOST * MOST], inverse[MOST * MOST], of[MOST * MOST], left[MOST * MOST];
    const int m = n - 1;
    for (int i = 0; i < m; i++) memcpy(of + i * m, A + i * n, (size_t)m * sizeof(double));
    memcpy(left, of, (size_t)(m * m) * sizeof(double));
    if (!eigenvalues(m, left, values)) return INFINITY;
    for (int j = 0; j < m; j++)
        if (values[2 * j + 1] >= 0.0) eigenvector(m, of, values + 2 * j, vectors + 2 * j * m);
    *pairs = columns_of(n, current, values, vectors, T);
    if (*pairs < 0) return INFINITY;
    memset(inverse, 0, (size_t)(n * n) * sizeof(double));
    for (int i = 0; i < n; i++) inverse[i * n + i] = 1.0;
    memcpy(left, T, (size_t)(n * n) * sizeof(double));
    if (!solved(n, n, left, inverse)) return INFINITY;
    multiplied(n, A, T, of), multiplied(n, inverse, of, found);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            const int there = i == j || (i < m && j == m) || (i < *pairs && j == (i ^ 1));
            if (!there && !(fabs(found[i * n + j]) <= LEFT_OUT)) return INFINITY;
            found[i * n + j] = there ? found[i * n + j] : 0.0;
        }
    found[n * n - 1] = 1.0;
    return bounded(n, T) * bounded(n, inverse);
}

size_t tr_device_workspace(const tr_device *d)
{
    return (size_t)states_of(d) * (size_t)(d->after * d->terms);
}

double tr_device_stages(const tr_device *d, const double *asked, double unit, double *space, tr_stages *found)
{
    double A[MOST * MOST], C[MOST * MOST], T[MOST * MOST], gain[MOST * MOST];
    int rows = 0, pairs;
    found->rest = 0.0;
    const int n = d->terms <= MOST ? scaled(d, A, C) : 0, m = n - 1;
    const double condition = n ? modal(n, d->plant, A, T, found->A, &pairs) : INFINITY;
    if (!(condition < INFINITY)) return INFINITY;
    for (int t = 0; t < d->terms; t++)
        for (int j = 0; j < n; j++) {
            double sum = 0.0;
            for (int i = 0; i < n; i++) sum += C[t * n + i] * T[i * n + j];
            found->C[t * n + j] = sum * d->input_scale / unit;
        }
    for (int t = 0; t < d->terms; t++) rows += d->root[t] > 0.0 ? d->after : 0;
    /* From the window's end on the command is zero: each mode goes on by itself. */
    for (int j = 0; j < m; j++) {
        const int other = j < pairs ? j ^ 1 : j;
        double *column = space + (size_t)j * (size_t)rows;
        for (int t = 0; t < d->terms; t++) {
            double own = d->root[t] * found->C[t * n + j], beside = d->root[t] * found->C[t * n + other];
            for (int k = 0; d->root[t] > 0.0 && k < d->after; k++) {
                const double before = own;
                *column++ = own;
                own = before * found->A[j * n + j] + (other == j ? 0.0 : beside * found->A[other * n + j]);
                beside = before * found->A[j * n + other] + beside * found->A[other * n + other];
                if (fabs(own) < VANISHED && fabs(beside) < VANISHED) own = beside = 0.0;
            }
        }
    }
    double *after = space + (size_t)m * (size_t)rows;
    for (int t = 0; t < d->terms; t++)
        for (int k = 0; d->root[t] > 0.0 && k < d->after; k++)
            *after++ = d->root[t] * asked[(size_t)t * (size_t)d->stride + (size_t)k] / unit;
    found->rest = reduced(rows, m, space, gain, found->end_target);
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) found->end_gain[i * n + j] = d->by * gain[i * m + j];
        found->end_gain[i * n + m] = 0.0, found->end_target[i] *= d->by;
    }
    return condition;
}
