// The scenes that `./vlaps bench planner --ompl` writes (README.md), and a
// collision check on their cells: the same one that the Rust planner has
// (planner/src/grid.rs, planner/src/segment.rs), so that only the search differs.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

struct Point
{
    double x, y;
};

// One size for all scenes of a file.
struct Layout
{
    std::uint32_t scenes, columns, rows, words_per_row;
    double cell_m, step_m, rewire_radius_m, goal_radius_m;
};

struct Scene
{
    Point goal;
    double x_max_m, right_m, left_m;
    std::vector<std::uint64_t> words;
};

class Grid
{
public:
    Grid(const Layout &layout, const Scene &scene) : layout_(layout), words_(scene.words.data()) {}

    bool isFree(Point point) const
    {
        const Point at = cells(point);
        return inside(at) && !any(cell(at.y, layout_.rows), cell(at.x, layout_.columns), cell(at.x, layout_.columns));
    }

    // Whether all cells that the straight line touches are free; exact.
    bool isSegmentFree(Point from_body, Point to_body) const
    {
        Point from = cells(from_body), to = cells(to_body);
        if (!inside(from) || !inside(to))
            return false;
        if (from.y > to.y)
            std::swap(from, to);
        const double low = std::min(from.x, to.x), high = std::max(from.x, to.x);
        const std::size_t first_row = cell(from.y - TOUCH, layout_.rows), last_row = cell(to.y + TOUCH, layout_.rows);
        // Most lines are far from obstacles: check their bounding rectangle first.
        if (isRectangleFree(first_row, last_row, cell(low - TOUCH, layout_.columns), cell(high + TOUCH, layout_.columns)))
            return true;
        const double rise = to.y - from.y;
        const bool level = rise <= TOUCH;
        const double columns_per_row = level ? 0.0 : (to.x - from.x) / rise;
        const auto x_at = [&](double y) { return from.x + (std::min(std::max(y, from.y), to.y) - from.y) * columns_per_row; };
        for (std::size_t row = first_row; row <= last_row; ++row)
        {
            const double enter = level ? low : x_at(double(row) - TOUCH);
            const double leave = level ? high : x_at(double(row) + 1.0 + TOUCH);
            if (any(row, cell(std::min(enter, leave) - TOUCH, layout_.columns),
                    cell(std::max(enter, leave) + TOUCH, layout_.columns)))
                return false;
        }
        return true;
    }

private:
    // Maximum distance at which a line touches a cell, in cells.
    static constexpr double TOUCH = 1e-9;
    static constexpr std::uint64_t ALL = ~std::uint64_t(0);

    static std::uint64_t fromColumn(std::size_t column) { return ALL << (column % 64); }
    static std::uint64_t toColumn(std::size_t column) { return ALL >> (63 - column % 64); }

    static std::size_t cell(double at, std::uint32_t count)
    {
        return std::size_t(std::min(std::max(std::int32_t(at), 0), std::int32_t(count) - 1));
    }

    Point cells(Point point) const
    {
        return {point.x / layout_.cell_m, point.y / layout_.cell_m + layout_.rows / 2};
    }

    bool inside(Point at) const
    {
        return at.x >= 0 && at.x <= layout_.columns && at.y >= 0 && at.y <= layout_.rows;
    }

    bool any(std::size_t row, std::size_t first, std::size_t last) const
    {
        const std::uint64_t *words = words_ + row * layout_.words_per_row;
        const std::size_t head = first / 64, tail = last / 64;
        if (head == tail)
            return words[head] & fromColumn(first) & toColumn(last);
        for (std::size_t word = head + 1; word < tail; ++word)
            if (words[word])
                return true;
        return (words[head] & fromColumn(first)) || (words[tail] & toColumn(last));
    }

    // May return false for a free rectangle that is wider than two words.
    bool isRectangleFree(std::size_t first_row, std::size_t last_row, std::size_t first, std::size_t last) const
    {
        const std::size_t head = first / 64, tail = last / 64;
        if (tail > head + 1)
            return false;
        std::uint64_t heads = 0, tails = 0;
        for (std::size_t row = first_row; row <= last_row; ++row)
        {
            heads |= words_[row * layout_.words_per_row + head];
            tails |= words_[row * layout_.words_per_row + tail];
        }
        if (head == tail)
            return !(heads & fromColumn(first) & toColumn(last));
        return !(heads & fromColumn(first)) && !(tails & toColumn(last));
    }

    Layout layout_;
    const std::uint64_t *words_;
};

inline void read(std::ifstream &file, void *to, std::size_t bytes)
{
    if (!file.read(static_cast<char *>(to), std::streamsize(bytes)))
        throw std::runtime_error("the scene file is cut off");
}

inline std::vector<Scene> readScenes(const std::string &path, Layout &layout)
{
    std::ifstream file(path, std::ios::binary);
    char magic[8];
    read(file, magic, sizeof magic);
    if (std::memcmp(magic, "VLAPSRRT", sizeof magic) != 0)
        throw std::runtime_error(path + " holds no scenes");
    read(file, &layout, sizeof layout);
    static_assert(sizeof(Layout) == 48, "as README.md says");
    std::vector<Scene> scenes(layout.scenes);
    for (Scene &scene : scenes)
    {
        double numbers[5];
        read(file, numbers, sizeof numbers);
        scene.goal = {numbers[0], numbers[1]};
        scene.x_max_m = numbers[2];
        scene.right_m = numbers[3];
        scene.left_m = numbers[4];
        scene.words.resize(std::size_t(layout.rows) * layout.words_per_row);
        read(file, scene.words.data(), scene.words.size() * sizeof(std::uint64_t));
    }
    return scenes;
}
